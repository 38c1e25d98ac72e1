/* The policy $title: see ${name}.h. Equations: Hasani et al. (ICRA 2020), supplement eq. 1-6.

   Compiled as double with IEEE arithmetic (no -ffast-math, -ffp-contract=off), every bit is that of
   rover-ncp's solver. */
#include <float.h>
#include <math.h>
#include <stdint.h>

#include "${name}.h"

#if FLT_EVAL_METHOD != 0
#error "needs arithmetic in the precision of its type (on x86: -mfpmath=sse)"
#endif

typedef ${name}_real real;

#ifdef ROVER_NCP_FLOAT
#define R(number) number##f
#else
#define R(number) number
#endif

static real larger(real a, real b) { return b > a ? b : a; }
static real smaller(real a, real b) { return b < a ? b : a; }
$exponential
void ${name}_reset(${name}_state *state)
{
    int i;
    for (i = 0; i < ${guard}_NEURONS; i++)
        state->potential[i] = R($resting_mV);
}

int ${name}_tick(${name}_state *state, const ${name}_real *observation, ${name}_real *command)
{
    real *const V = state->potential;
$locals
    int i;

    for (i = 0; i < ${guard}_OUTPUTS; i++)
        command[i] = R(0.0);
    for (i = 0; i < ${guard}_INPUTS; i++)
        if (!isfinite(observation[i]))
            return -1;

    /* Sensory neurons. */
$sensors

    /* Constant over the tick: leak, and synapses from sensory neurons. */
$input_synapses

    /* $substeps steps of $dt_s s, each from the old potentials of all. */
    for (i = 0; i < $substeps; i++) {
$integrated
    }

    /* Motor neurons. */
$motors
    return 0;
}
