/* Scales of a powder in a gas. SI units, or any others that agree. */
#ifndef FAVRE_SCALES_H
#define FAVRE_SCALES_H

#include <math.h>

/* True terminal velocity of one sphere: the drag of Schiller and Naumann solved, not Stokes' value.
 * Ar = 3/4 C_D Re^2, C_D Re = 24 + 3.6 Re^0.687 below Re = 1000 and 0.44 Re above. */
static inline double favre_terminal_velocity(
    double d, double rho_s, double rho_g, double mu_g, double g)
{
    double archimedes = rho_g*(rho_s - rho_g)*g*d*d*d/(mu_g*mu_g);
    double re = archimedes/18.0/(1.0 + 0.05*pow(archimedes, 0.4));
    int i;
    for (i = 0; i < 50; i++) {
        double power = pow(re, 0.687);
        double step = (18.0*re + 2.7*re*power - archimedes)/(18.0 + 2.7*1.687*power);
        re = re - step > 0.1*re ? re - step : 0.1*re;
        if (fabs(step) <= 1e-15*re) break;
    }
    if (re >= 1000.0) {
        re = sqrt(archimedes/0.33);
        if (re < 1000.0) re = 1000.0;
    }
    return re*mu_g/(rho_g*d);
}

#endif
