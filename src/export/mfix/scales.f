
  ! True terminal velocity of one sphere: the drag of Schiller and Naumann solved, not Stokes' value.
  ! Ar = 3/4 C_D Re^2, C_D Re = 24 + 3.6 Re^0.687 below Re = 1000 and 0.44 Re above.
  pure function terminal_velocity(d, rho_s, rho_g, mu_g, g) result(u_t)
    real(dp), intent(in) :: d, rho_s, rho_g, mu_g, g
    real(dp) :: u_t
    real(dp) :: archimedes, re, power, step
    integer :: i
    archimedes = rho_g*(rho_s - rho_g)*g*d**3/mu_g**2
    re = archimedes/18.0_dp/(1.0_dp + 0.05_dp*archimedes**0.4_dp)
    do i = 1, 50
      power = re**0.687_dp
      step = (18.0_dp*re + 2.7_dp*re*power - archimedes)/(18.0_dp + 2.7_dp*1.687_dp*power)
      re = max(re - step, 0.1_dp*re)
      if (abs(step) <= 1e-15_dp*re) exit
    end do
    if (re >= 1000.0_dp) re = max(sqrt(archimedes/0.33_dp), 1000.0_dp)
    u_t = re*mu_g/(rho_g*d)
  end function terminal_velocity

  pure function reference_length(u_t, g, d) result(y)
    real(dp), intent(in) :: u_t, g, d
    real(dp) :: y
    y = {{length}}
    if (d <= 0.0_dp) y = huge(y)
  end function reference_length

  ! Edge of a cube of the cell's volume, or of a square of its area in two dimensions.
  pure function cell_width(volume, area, three) result(y)
    double precision, intent(in) :: volume, area
    logical, intent(in) :: three
    real(dp) :: y
    if (three) then
      y = volume**(1.0_dp/3.0_dp)
    else
      y = sqrt(area)
    end if
  end function cell_width
