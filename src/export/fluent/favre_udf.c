/*
{{about}} */

/* Before udf.h, whose macros are not to meet these names. */
#include "favre_closure.h"
#include "favre_scales.h"
#include "udf.h"

/* To be set. SI units. */
#define FAVRE_FILTER_RATIO 2.0 /* filter width over cell width; the width is the cell's volume^(1/3) */
#define FAVRE_GRAVITY {{gravity}}
#define FAVRE_GAS 0 /* domain index of the gas among the phases: the primary phase */

typedef struct {
    double u_t;   /* true terminal velocity */
    double width; /* filter width over the reference length */
} favre_scales;

static favre_scales favre_scales_of(cell_t c, Thread *gas, Thread *solids)
{
    favre_scales scales;
    double g = FAVRE_GRAVITY, d = C_PHASE_DIAMETER(c, solids);
    double u_t = favre_terminal_velocity(d, C_R(c, solids), C_R(c, gas), C_MU_L(c, gas), g);
    double length = {{length}};
#if RP_2D
    double cell = sqrt(C_VOLUME(c, solids));
#else
    double cell = pow(C_VOLUME(c, solids), 1.0/3.0);
#endif
    scales.u_t = u_t;
    scales.width = FAVRE_FILTER_RATIO*cell/length;
    return scales;
}

static double favre_slip(cell_t c, Thread *gas, Thread *solids)
{
    double u = C_U(c, gas) - C_U(c, solids), v = C_V(c, gas) - C_V(c, solids), w = 0.0;
#if RP_3D
    w = C_W(c, gas) - C_W(c, solids);
#endif
    return sqrt(u*u + v*v + w*w);
}

/* 1 - H, not below zero. */
static double favre_factor(cell_t c, Thread *gas, Thread *solids)
{
    favre_scales scales = favre_scales_of(c, gas, solids);
    double phi = C_VOF(c, solids), D = scales.width;
    double V = favre_slip(c, gas, solids)/scales.u_t;
    (void)V;
    return {{factor}};
}
{{hooks}}
