{{about}}!
! The filtered viscosity, second viscosity and pressure of solids phase M. Other user properties that
! a case needs go beside this routine, as in MFIX's own usr_properties.f.
      SUBROUTINE USR_PROP_MUS(IJK, M)

      use constant, only: GRAVITY
      use fldvar, only: ep_s, p_s, ro_s, d_p, ro_g
      use geometry, only: VOL, AXY, DO_K
      use physprop, only: mu_g
      use visc_s, only: mu_s, lambda_s

      IMPLICIT NONE

      INTEGER, PARAMETER :: dp = kind(1.0d0)

! To be set: filter width over cell width
      real(dp), parameter :: filter_size_ratio = 2.0_dp

! Fluid cell; solids phase
      INTEGER, INTENT(IN) :: IJK, M

{{constants}}      real(dp) :: phi, D, S, u_t, cell, third
      real(dp) :: gradient(3, 3), rate(3, 3)
      integer :: i

      u_t = terminal_velocity(d_p(IJK,M), ro_s(IJK,M), ro_g(IJK), mu_g(IJK), GRAVITY)
      cell = cell_width(VOL(IJK), AXY(IJK), DO_K)
      phi = ep_s(IJK,M)
      D = filter_size_ratio*cell/reference_length(u_t, GRAVITY, d_p(IJK,M))

! S = sqrt(2 Sd:Sd), Sd the deviator of the symmetric gradient of the solids velocity
      call CALC_DERIV_VEL_SOLIDS(IJK, M, gradient, rate)
      third = (rate(1,1) + rate(2,2) + rate(3,3))/3.0_dp
      do i = 1, 3
        rate(i,i) = rate(i,i) - third
      end do
      S = sqrt(2.0_dp*sum(rate**2))*u_t/GRAVITY

      mu_s(IJK,M) = max(0.0_dp, &
        {{viscosity}})*ro_s(IJK,M)*u_t**3/GRAVITY
      lambda_s(IJK,M) = -2.0_dp/3.0_dp*mu_s(IJK,M)
      p_s(IJK,M) = max(0.0_dp, &
        {{pressure}})*ro_s(IJK,M)*u_t**2

      contains

{{functions}}{{scales}}
      END SUBROUTINE USR_PROP_MUS
