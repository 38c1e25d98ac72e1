/* The policy {{ policy.circuit.name }} as C: from an observation to a command.

   Made by rover-ncp {{ version }}. C99; no allocation, no static state. Define ROVER_NCP_FLOAT for float
   instead of double.

   observation: {{ policy.sensing.inputs|comment }}
   command: {{ policy.motors.outputs|comment }}
   (m, rad, m/s and rad/s)

       {{ name }}_state state;
       {{ name }}_reset(&state);
       every {{ policy.tick_s }} s: {{ name }}_tick(&state, observation, command);
{% if course %}

   A drive of the course {{ course.name }}, from rest at its start:

       {{ name }}_course course;
       {{ name }}_reset(&state);
       {{ name }}_course_start(&course);
       {{ name }}_observe(&course, x, y, theta, observation);
       {{ name }}_tick(&state, observation, command);             warm-up: discard this command
       every {{ tick_s }} s, {{ NAME }}_COURSE_TICKS times:
           {{ name }}_course_advance(&course);
           {{ name }}_observe(&course, x, y, theta, observation);
           {{ name }}_tick(&state, observation, command);

   The pose is that of the base in the course's frame: x, y in m, theta in rad within (-pi, pi].
{% endif %}
*/
#ifndef ROVER_NCP_{{ NAME }}_H
#define ROVER_NCP_{{ NAME }}_H

#ifdef __cplusplus
extern "C" {
#endif

#ifdef ROVER_NCP_FLOAT
typedef float {{ name }}_real;
#else
typedef double {{ name }}_real;
#endif

enum { {{ NAME }}_INPUTS = {{ policy.sensing.inputs|length }}, {{ NAME }}_OUTPUTS = {{ policy.motors.outputs|length }}, {{ NAME }}_NEURONS = {{ policy.circuit.size }} };

/* Potentials in mV of {{ policy.circuit.neurons|join(", ") }}. */
typedef struct {
    {{ name }}_real potential[{{ NAME }}_NEURONS];
} {{ name }}_state;

/* Put every neuron at rest. */
void {{ name }}_reset({{ name }}_state *state);

/* Run one control tick. Returns 0; or -1 if a number of the observation is not finite. The state is then
   unchanged and the command 0. */
int {{ name }}_tick({{ name }}_state *state, const {{ name }}_real *observation, {{ name }}_real *command);
{% if course %}

enum { {{ NAME }}_COURSE_TICKS = {{ course.ticks }} };

/* The tick, -1 for the warm-up
   {%- if course.reference %}; the reference at its start in m, rad (not wrapped), m/s and rad/s{% endif %}. */
typedef struct {
    int tick;
{% if course.reference %}
    {{ name }}_real x, y, theta, v, omega;
{% endif %}
} {{ name }}_course;

void {{ name }}_course_start({{ name }}_course *course);
void {{ name }}_course_advance({{ name }}_course *course);

/* Fill in an observation, the input of {{ name }}_tick. */
void {{ name }}_observe(const {{ name }}_course *course, {{ name }}_real x, {{ name }}_real y, {{ name }}_real theta,
     {{ name }}_real *observation);
{% endif %}

#ifdef __cplusplus
}
#endif

#endif
