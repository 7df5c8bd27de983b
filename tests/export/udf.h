/* The documented macros of Fluent that the exported functions use, for one cell; for tests. */
#ifndef UDF_H
#define UDF_H

typedef double real;
typedef int cell_t;

typedef struct Thread {
    double velocity[3], gradient[3][3], volume, fraction, density, viscosity, diameter;
    struct Thread *super, *sub[2];
} Thread;

#define RP_2D 0
#define RP_3D 1
#define C_U(c, t) ((t)->velocity[(c)*0])
#define C_V(c, t) ((t)->velocity[(c)*0 + 1])
#define C_W(c, t) ((t)->velocity[(c)*0 + 2])
#define C_DUDX(c, t) ((t)->gradient[(c)*0][0])
#define C_DUDY(c, t) ((t)->gradient[(c)*0][1])
#define C_DUDZ(c, t) ((t)->gradient[(c)*0][2])
#define C_DVDX(c, t) ((t)->gradient[(c)*0 + 1][0])
#define C_DVDY(c, t) ((t)->gradient[(c)*0 + 1][1])
#define C_DVDZ(c, t) ((t)->gradient[(c)*0 + 1][2])
#define C_DWDX(c, t) ((t)->gradient[(c)*0 + 2][0])
#define C_DWDY(c, t) ((t)->gradient[(c)*0 + 2][1])
#define C_DWDZ(c, t) ((t)->gradient[(c)*0 + 2][2])
#define C_VOLUME(c, t) ((t)->volume + 0*(c))
#define C_VOF(c, t) ((t)->fraction + 0*(c))
#define C_R(c, t) ((t)->density + 0*(c))
#define C_MU_L(c, t) ((t)->viscosity + 0*(c))
#define C_PHASE_DIAMETER(c, t) ((t)->diameter + 0*(c))
#define THREAD_SUB_THREAD(t, i) ((t)->sub[i])
#define THREAD_SUPER_THREAD(t) ((t)->super)
#define DEFINE_EXCHANGE_PROPERTY(name, c, t, first, second) \
    real name(cell_t c, Thread *t, int first, int second)
#define DEFINE_PROPERTY(name, c, t) real name(cell_t c, Thread *t)

#endif
