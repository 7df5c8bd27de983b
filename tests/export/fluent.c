/* Reads states of a cell (fraction, volume, slip along three axes, nine gradients, particle
 * diameter) and writes the drag, its factor, the viscosity and the pressure. */
#include "favre_udf.c"
#include <stdio.h>

int main(void)
{
    double in[15], out[4] = {0, 0, 0, 0};
    int i;
    while (fread(in, sizeof in, 1, stdin) == 1) {
        Thread gas = {0}, solids = {0}, mixture = {0};
        gas.velocity[0] = 0.25;
        solids.velocity[0] = 0.25 - in[2];
        solids.velocity[1] = -in[3];
        solids.velocity[2] = -in[4];
        for (i = 0; i < 9; i++) solids.gradient[i/3][i%3] = in[5 + i];
        solids.fraction = in[0];
        solids.volume = gas.volume = in[1];
        solids.density = DENSITY_S;
        solids.diameter = in[14];
        gas.density = DENSITY_G;
        gas.viscosity = VISCOSITY_G;
        mixture.sub[0] = &gas;
        mixture.sub[1] = &solids;
        gas.super = solids.super = &mixture;
#ifdef DRAG
        out[0] = favre_udf_drag(0, &mixture, 0, 1);
        out[1] = favre_udf_drag_factor(0, &mixture, 0, 1);
#endif
#ifdef STRESS
        out[2] = favre_udf_solids_viscosity(0, &solids);
        out[3] = favre_udf_solids_pressure(0, &solids);
#endif
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
