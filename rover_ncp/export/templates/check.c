/* Test vectors for ${name}.c: exits 0 if this build computes what rover-ncp's solver did.

       cc -std=c99 -O2 -ffp-contract=off -o check $sources -lm && ./check

   As double every bit of a command must agree; as float, a command to $float_tolerance. */
#include <math.h>
#include <stdio.h>

#include "$header"

typedef ${name}_real real;

#ifdef ROVER_NCP_FLOAT
#define R(number) number##f
#define COMMAND_TOLERANCE $float_tolerance
#define SEEN_TOLERANCE 1e-5
#else
#define R(number) number
#define COMMAND_TOLERANCE 0.0
#define SEEN_TOLERANCE 1e-9
#endif

enum { TICKS = $tick_count };

$poses
static const real observations[TICKS][${guard}_INPUTS] = {
$observations
};
static const real commands[TICKS][${guard}_OUTPUTS] = {
$commands
};

static double apart(double most, const real *a, const real *b, int count)
{
    int i;
    for (i = 0; i < count; i++)
        most = fmax(most, fabs((double)a[i] - (double)b[i]));
    return most;
}

int main(void)
{
    ${name}_state state;
    real command[${guard}_OUTPUTS];
    double seen_apart = 0.0, commands_apart = 0.0;
    int k;
$start
    ${name}_reset(&state);
    for (k = 0; k < TICKS; k++) {
$see
        if (${name}_tick(&state, observations[k], command) != 0)
            return 1;
        commands_apart = apart(commands_apart, command, commands[k], ${guard}_OUTPUTS);
    }
    printf("%d ticks: observations within %g, commands within %g\n", TICKS, seen_apart, commands_apart);
    return seen_apart <= SEEN_TOLERANCE && commands_apart <= COMMAND_TOLERANCE ? 0 : 1;
}
