
/* Exchange coefficient K_gs = (1 - H) beta [kg/m3/s]. The gas is the first phase of the pair. */
DEFINE_EXCHANGE_PROPERTY(favre_udf_drag, c, mixture_thread, first_phase, second_phase)
{
    Thread *gas = THREAD_SUB_THREAD(mixture_thread, first_phase);
    Thread *solids = THREAD_SUB_THREAD(mixture_thread, second_phase);
    double d = C_PHASE_DIAMETER(c, solids), mu_g = C_MU_L(c, gas);
    double phi = C_VOF(c, solids);
    double base, re;
    phi = phi < 0.0 ? 0.0 : phi > 0.99 ? 0.99 : phi;
    re = (1.0 - phi)*C_R(c, gas)*d*favre_slip(c, gas, solids)/mu_g;
    base = phi*{{base}}(phi, re)*mu_g/(d*d);
    return favre_factor(c, gas, solids)*base;
}

/* The factor 1 - H alone, to modify a drag law that the panel offers. */
DEFINE_EXCHANGE_PROPERTY(favre_udf_drag_factor, c, mixture_thread, first_phase, second_phase)
{
    Thread *gas = THREAD_SUB_THREAD(mixture_thread, first_phase);
    Thread *solids = THREAD_SUB_THREAD(mixture_thread, second_phase);
    return favre_factor(c, gas, solids);
}
