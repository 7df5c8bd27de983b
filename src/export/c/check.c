/* Compares every test vector of the closure. Exit status 0: all agree to 1e-12.
 *   cc -O2 check.c -o check -lm && ./check */
#include "favre_closure.h"
#include <stdio.h>

static int failed, compared;
static double worst;

static void compare(const char *name, int i, double found, double expected)
{
    double scale = fabs(expected) > 1.0 ? fabs(expected) : 1.0;
    double error = fabs(found - expected)/scale;
    compared++;
    if (error > worst) worst = error;
    if (error <= 1e-12) return;
    failed++;
    printf("%s, vector %d: %.17g, expected %.17g\n", name, i + 1, found, expected);
}

int main(void)
{
    int i;
{{tests}}    printf("%s: %d test vectors, %d differ, largest error %.1e\n",
        FAVRE_CLOSURE_NAME, compared, failed, worst);
    return failed || !compared;
}
