/* Test vectors for {{ name }}.c: exits 0 if this build computes what rover-ncp's solver did.

       cc -std=c99 -O2 -ffp-contract=off -o check {{ name }}_check.c {{ name }}.c -lm && ./check

   As double every bit of a command must agree; as float, a command to 1e-4. */
#include <math.h>
#include <stdio.h>

#include "{{ name }}.h"

typedef {{ name }}_real real;

#ifdef ROVER_NCP_FLOAT
#define R(number) number##f
#define COMMAND_TOLERANCE 1e-4
#define OBSERVATION_TOLERANCE 1e-5
#else
#define R(number) number
#define COMMAND_TOLERANCE 0.0
#define OBSERVATION_TOLERANCE 1e-9
#endif

enum { TICKS = {{ observations|length }} };
{% for table, rows, columns in [("poses", poses, "3"), ("observations", observations, NAME ~ "_INPUTS"), ("commands", commands, NAME ~ "_OUTPUTS")] if rows %}

static const real {{ table }}[TICKS][{{ columns }}] = {
{% for row in rows %}
    { {{- row|map("real")|join(", ") -}} },
{% endfor %}
};
{% endfor %}

static double apart(double most, const real *a, const real *b, int count)
{
    int i;
    for (i = 0; i < count; i++) {
        double difference = fabs((double)a[i] - (double)b[i]);
        if (most == most && !(difference <= most)) /* a NaN counts, and stays */
            most = difference;
    }
    return most;
}

int main(void)
{
    {{ name }}_state state;
    real command[{{ NAME }}_OUTPUTS];
    double observations_apart = 0.0, commands_apart = 0.0;
    int k;
{% if course %}
    {{ name }}_course course;
    real observed[{{ NAME }}_INPUTS];

    {{ name }}_course_start(&course);
{% endif %}
    {{ name }}_reset(&state);
    for (k = 0; k < TICKS; k++) {
{% if course %}
        {{ name }}_observe(&course, poses[k][0], poses[k][1], poses[k][2], observed);
        observations_apart = apart(observations_apart, observed, observations[k], {{ NAME }}_INPUTS);
        {{ name }}_course_advance(&course);
{% endif %}
        if ({{ name }}_tick(&state, observations[k], command) != 0)
            return 1;
        commands_apart = apart(commands_apart, command, commands[k], {{ NAME }}_OUTPUTS);
    }
    printf("%d ticks: observations within %g, commands within %g\n", TICKS, observations_apart, commands_apart);
    return observations_apart <= OBSERVATION_TOLERANCE && commands_apart <= COMMAND_TOLERANCE ? 0 : 1;
}
