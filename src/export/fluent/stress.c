
/* sqrt(2 Sd:Sd) of the solids velocity, Sd the deviator of the symmetric gradient. */
static double favre_shear_rate(cell_t c, Thread *solids)
{
    double xx = C_DUDX(c, solids), yy = C_DVDY(c, solids), zz = 0.0, third;
    double xy = 0.5*(C_DUDY(c, solids) + C_DVDX(c, solids)), xz = 0.0, yz = 0.0;
#if RP_3D
    zz = C_DWDZ(c, solids);
    xz = 0.5*(C_DUDZ(c, solids) + C_DWDX(c, solids));
    yz = 0.5*(C_DVDZ(c, solids) + C_DWDY(c, solids));
    third = (xx + yy + zz)/3.0;
#else
    third = (xx + yy)/3.0;
#endif
    xx -= third;
    yy -= third;
    zz -= third;
    return sqrt(2.0*(xx*xx + yy*yy + zz*zz + 2.0*(xy*xy + xz*xz + yz*yz)));
}

/* Granular viscosity [Pa s], of the solids phase. */
DEFINE_PROPERTY(favre_udf_solids_viscosity, c, solids)
{
    Thread *gas = THREAD_SUB_THREAD(THREAD_SUPER_THREAD(solids), FAVRE_GAS);
    favre_scales scales = favre_scales_of(c, gas, solids);
    double phi = C_VOF(c, solids), D = scales.width, u_t = scales.u_t;
    double S = favre_shear_rate(c, solids)*u_t/FAVRE_GRAVITY;
    (void)phi; (void)D; (void)S;
    return favre_max(0.0, {{viscosity}})*C_R(c, solids)*u_t*u_t*u_t/FAVRE_GRAVITY;
}

/* Solids pressure [Pa], of the solids phase. */
DEFINE_PROPERTY(favre_udf_solids_pressure, c, solids)
{
    Thread *gas = THREAD_SUB_THREAD(THREAD_SUPER_THREAD(solids), FAVRE_GAS);
    favre_scales scales = favre_scales_of(c, gas, solids);
    double phi = C_VOF(c, solids), D = scales.width, u_t = scales.u_t;
    double S = favre_shear_rate(c, solids)*u_t/FAVRE_GRAVITY;
    (void)phi; (void)D; (void)S;
    return favre_max(0.0, {{pressure}})*C_R(c, solids)*u_t*u_t;
}
