{{about}}!
! Pure functions; nothing is needed beside the compiler.
module favre_closure
  implicit none
  private
  integer, parameter :: dp = kind(1.0d0)
{{name}}{{hash}}{{reference}}{{public}}{{constants}}
contains

{{functions}}
end module favre_closure
