/*
{{about}} *
 * Pure functions; nothing is needed but math.h.
 */
#ifndef FAVRE_CLOSURE_H
#define FAVRE_CLOSURE_H

#include <math.h>

#define FAVRE_CLOSURE_NAME {{name}}
#define FAVRE_CLOSURE_SHA256 "{{hash}}"
#define FAVRE_CLOSURE_REFERENCE {{reference}}

/* Of what is not a number nothing is hidden. */
static inline double favre_min(double a, double b) { return a < b || a != a ? a : b; }
static inline double favre_max(double a, double b) { return a > b || a != a ? a : b; }
static inline double favre_square(double a) { return a*a; }
static inline double favre_cube(double a) { return a*a*a; }
static inline double favre_three_halves(double a) { return a*sqrt(a); }
static inline double favre_clamp(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

{{routines}}{{quantities}}
#endif
