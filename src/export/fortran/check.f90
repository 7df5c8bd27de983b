! Compares every test vector of the closure. Exit status 0: all agree to 1e-12.
!   gfortran -O2 favre_closure.f90 check.f90 -o check && ./check
program check
  use favre_closure
  implicit none
  integer, parameter :: dp = kind(1.0d0)
  integer :: compared = 0, failed = 0
  real(dp) :: worst = 0

{{tests}}
  write(*, '(a, i0, a, i0, a, es7.1)') favre_closure_name // ': ', compared, &
    ' test vectors, ', failed, ' differ, largest error ', worst
  if (failed > 0 .or. compared == 0) stop 1

contains

  subroutine compare(name, i, found, expected)
    character(len=*), intent(in) :: name
    integer, intent(in) :: i
    real(dp), intent(in) :: found, expected
    real(dp) :: error
    error = abs(found - expected)/max(abs(expected), 1.0_dp)
    compared = compared + 1
    worst = max(worst, error)
    if (error <= 1e-12_dp) return
    failed = failed + 1
    write(*, *) name, ', vector', i, ':', found, ', expected', expected
  end subroutine compare
end program check
