{{about}}!
! lDgA = (1 - H) beta/eps_s [kg/m3/s]: MFIX multiplies by eps_s itself.
      SUBROUTINE DRAG_USR(IJK, M_NP, lDgA, EPg, Mug, ROg, VREL, DPM, &
         ROs, lUg, lVg, lWg)

      use constant, only: GRAVITY
      use geometry, only: VOL, AXY, DO_K

      IMPLICIT NONE

      INTEGER, PARAMETER :: dp = kind(1.0d0)

! To be set: filter width over cell width
      real(dp), parameter :: filter_size_ratio = 2.0_dp

! Fluid cell; solids phase
      INTEGER, INTENT(IN) :: IJK, M_NP
      DOUBLE PRECISION, INTENT(OUT) :: lDgA
! Gas fraction, viscosity, density; slip speed; particle diameter and density
      DOUBLE PRECISION, INTENT(IN) :: EPg, Mug, ROg, VREL, DPM, ROs
! Gas velocity; not used
      DOUBLE PRECISION, INTENT(IN) :: lUg, lVg, lWg

{{constants}}      real(dp) :: phi, D, V, u_t, cell, base, re

      u_t = terminal_velocity(DPM, ROs, ROg, Mug, GRAVITY)
      cell = cell_width(VOL(IJK), AXY(IJK), DO_K)
      phi = 1.0_dp - EPg
      D = filter_size_ratio*cell/reference_length(u_t, GRAVITY, DPM)
      V = VREL/u_t
      lDgA = max(0.0_dp, 1.0_dp - {{drag}})

      phi = min(max(phi, 0.0_dp), 0.99_dp)
      re = (1.0_dp - phi)*ROg*DPM*VREL/Mug
      base = {{base}}(phi, re)
      lDgA = lDgA*base*Mug/DPM**2

      contains

{{functions}}{{scales}}
      END SUBROUTINE DRAG_USR
