  ! Of what is not a number nothing is hidden.
  elemental function favre_min(a, b) result(y)
    real(dp), intent(in) :: a, b
    real(dp) :: y
    y = merge(a, b, a < b .or. a /= a)
  end function favre_min

  ! Of what is not a number nothing is hidden.
  elemental function favre_max(a, b) result(y)
    real(dp), intent(in) :: a, b
    real(dp) :: y
    y = merge(a, b, a > b .or. a /= a)
  end function favre_max

  elemental function favre_clamp(x, low, high) result(y)
    real(dp), intent(in) :: x, low, high
    real(dp) :: y
    y = merge(low, merge(high, x, x > high), x < low)
  end function favre_clamp

