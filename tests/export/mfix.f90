! The names of MFIX that the exported routines use, for one cell, and a program that reads states of it
! and writes what they give; for tests.
module constant
  double precision :: GRAVITY
end module constant
module geometry
  double precision :: VOL(1), AXY(1)
  logical :: DO_K = .true.
end module geometry
module fldvar
  double precision :: ep_s(1,1), p_s(1,1), ro_s(1,1), d_p(1,1), ro_g(1)
end module fldvar
module physprop
  double precision :: mu_g(1)
end module physprop
module visc_s
  double precision :: mu_s(1,1), lambda_s(1,1)
end module visc_s
module state
  double precision :: gradient(3,3)
end module state

subroutine CALC_DERIV_VEL_SOLIDS(IJK, M, lVelGradS, lRateStrainS)
  use state, only: gradient
  integer, intent(in) :: IJK, M
  double precision, intent(out) :: lVelGradS(3,3), lRateStrainS(3,3)
  lVelGradS = gradient*IJK*M
  lRateStrainS = 0.5d0*(gradient + transpose(gradient))
end subroutine CALC_DERIV_VEL_SOLIDS

program mfix
  use constant
  use geometry
  use fldvar
  use physprop
  use visc_s
  use state
  double precision :: in(15), out(4), slip
  integer :: status
  GRAVITY = GRAVITY_SI
  ro_s = DENSITY_S
  ro_g = DENSITY_G
  mu_g = VISCOSITY_G
  open(10, file='states.bin', access='stream', form='unformatted', status='old')
  open(11, file='values.bin', access='stream', form='unformatted', status='replace')
  do
    read(10, iostat=status) in
    if (status /= 0) exit
    ep_s = in(1)
    VOL = in(2)
    d_p = in(15)
    slip = sqrt(in(3)**2 + in(4)**2 + in(5)**2)
    gradient = transpose(reshape(in(6:14), [3, 3]))
    out = 0
#ifdef DRAG
    call DRAG_USR(1, 1, out(1), 1 - in(1), mu_g(1), ro_g(1), slip, d_p(1,1), ro_s(1,1), 0d0, 0d0, 0d0)
#endif
#ifdef STRESS
    call USR_PROP_MUS(1, 1)
    out(3) = mu_s(1,1)
    out(4) = p_s(1,1)
    if (lambda_s(1,1) /= -2d0/3d0*mu_s(1,1)) stop 1
#endif
    write(11) out
  end do
end program mfix
