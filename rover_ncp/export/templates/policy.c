/* The policy {{ policy.circuit.name }}: see {{ name }}.h. Equations: Hasani et al. (ICRA 2020), supplement eq. 1-6.

   Compiled as double with IEEE arithmetic (no -ffast-math, -ffp-contract=off), every bit of a command is that
   of rover-ncp's solver. */
#include <float.h>
#include <math.h>
#include <stdint.h>

#include "{{ name }}.h"

#if FLT_EVAL_METHOD != 0
#error "needs arithmetic in the precision of its type (on x86: -mfpmath=sse)"
#endif

typedef {{ name }}_real real;

#ifdef ROVER_NCP_FLOAT
#define R(number) number##f
#define COS cosf
#define SIN sinf
#define REMAINDER remainderf
#else
#define R(number) number
#define COS cos
#define SIN sin
#define REMAINDER remainder
#endif

static real larger(real a, real b) { return b > a ? b : a; }
static real smaller(real a, real b) { return b < a ? b : a; }
{% if chemical %}

/* 2^z for -1000 <= z <= 1000 (within 2 ulp). Adding the rounder leaves the nearest integer in the sum's lowest
   bits; a polynomial gives 2^f for the rest f in [-1/2, 1/2]. As float: the same to degree {{ float_terms - 1 }}, z is cut to
   the type's exponents. */
static real power_of_two(real z)
{
#ifdef ROVER_NCP_FLOAT
    union { float value; uint32_t bits; } shifted, scaled;
    float f;
    z = larger(-126.0f, smaller(126.0f, z));
    shifted.value = z + 12582912.0f;
    f = z - (shifted.value - 12582912.0f);
    scaled.value = {{ exponential[float_terms - 1] }}f;
{% for term in exponential[:float_terms - 1]|reverse %}
    scaled.value = scaled.value * f + {{ term }}f;
{% endfor %}
    scaled.bits += shifted.bits << 23;
#else
    union { double value; uint64_t bits; } shifted, scaled;
    double f, f2, f4, low, middle, high;
    shifted.value = z + 6755399441055744.0;
    f = z - (shifted.value - 6755399441055744.0);
    f2 = f * f;
    f4 = f2 * f2;
{% for part in ["low", "middle", "high"] %}
{% set c = exponential[4 * loop.index0:] %}
    {{ part }} = ({{ c[0] }} + {{ c[1] }} * f) + ({{ c[2] }} + {{ c[3] }} * f) * f2;
{% endfor %}
    scaled.value = low + (middle + high * f4) * f4;
    scaled.bits += shifted.bits << 52;
#endif
    return scaled.value;
}

/* Conductance in S of a chemical synapse; slope is -sigma log2(e). */
static real conductance(real weight, real slope, real potential)
{
    return weight / (R(1.0) + power_of_two(slope * (potential - {{ midpoint_mV|real }})));
}
{% endif %}

void {{ name }}_reset({{ name }}_state *state)
{
    int i;
    for (i = 0; i < {{ NAME }}_NEURONS; i++)
        state->potential[i] = {{ resting_mV|real }};
}
{% macro add(synapse, current, total) -%}
{% if synapse.slope is none -%}
{{ current }} += {{ synapse.weight|real }} * V[{{ synapse.source }}];
{%- else -%}
value = conductance({{ synapse.weight|real }}, {{ synapse.slope|real }}, V[{{ synapse.source }}]); {{ total }} += value;
{%- if synapse.inhibitory %} {{ current }} += {{ inhibitory_mV|real }} * value;{% endif %}
{%- endif %}
{%- endmacro %}

int {{ name }}_tick({{ name }}_state *state, const {{ name }}_real *observation, {{ name }}_real *command)
{
    real *const V = state->potential;
    real value, channel[{{ policy.motors.channels|length }}];
{% if integrated %}
    real current[{{ integrated|length }}], total[{{ integrated|length }}], next[{{ integrated|length }}], sum, all;
{% endif %}
    int i;

    for (i = 0; i < {{ NAME }}_OUTPUTS; i++)
        command[i] = R(0.0);
    for (i = 0; i < {{ NAME }}_INPUTS; i++)
        if (!isfinite(observation[i]))
            return -1;

    /* Sensory neurons. */
{% for sensor in sensors %}
    value = {{ 0.0|real if sensor.layer else "observation[%d]"|format(sensor.channel) }};
{% for entry in sensor.layer %}
    value += {{ entry|real }} * observation[{{ loop.index0 }}];
{% endfor %}
{% for neuron, base, gain, lower, upper in sensor.neurons %}
    V[{{ neuron }}] = smaller(larger({{ lower|real }}, {{ base|real }} + {{ gain|real }} * value), {{ upper|real }}); /* {{ policy.circuit.neurons[neuron] }} */
{% endfor %}
{% endfor %}

    /* Constant over the tick: leak, and synapses from sensory neurons. */
{% for each in integrated %}
{% set d = loop.index0 %}
    /* {{ policy.circuit.neurons[each.neuron] }} */
    current[{{ d }}] = {{ each.current|real }};
    total[{{ d }}] = {{ each.conductance|real }};
{% for synapse in each.inputs %}
    {{ add(synapse, "current[%d]"|format(d), "total[%d]"|format(d)) }}
{% endfor %}
{% endfor %}

    /* {{ policy.substeps }} steps of {{ policy.dt_s }} s, each from the old potentials of all. */
    for (i = 0; i < {{ policy.substeps }}; i++) {
{% for each in integrated %}
        /* {{ policy.circuit.neurons[each.neuron] }} */
        sum = current[{{ loop.index0 }}] + {{ each.rate|real }} * V[{{ each.neuron }}];
        all = total[{{ loop.index0 }}];
{% for synapse in each.recurrent %}
        {{ add(synapse, "sum", "all") }}
{% endfor %}
        next[{{ loop.index0 }}] = sum / all;
{% endfor %}
{% for each in integrated %}
        V[{{ each.neuron }}] = next[{{ loop.index0 }}];
{% endfor %}
    }

    /* Motor neurons. */
    for (i = 0; i < {{ policy.motors.channels|length }}; i++)
        channel[i] = R(0.0);
{% for neuron, channel, end in motors %}
    value = smaller(larger((V[{{ neuron }}] - {{ motor_low|real }}) * {{ motor_scale|real }}, R(0.0)), R(1.0)); /* {{ policy.circuit.neurons[neuron] }} */
    channel[{{ channel }}] += {{ end|real }} * value;
{% endfor %}
{% for layer, limit in outputs %}
    value = {{ "channel[%d]"|format(loop.index0) if layer is none else 0.0|real }};
{% for entry in layer or [] %}
    value += {{ entry|real }} * channel[{{ loop.index0 }}];
{% endfor %}
    command[{{ loop.index0 }}] = {{ "value" if limit is none else "%s * smaller(larger(value, R(-1.0)), R(1.0))"|format(limit|real) }};
{% endfor %}
    return 0;
}
{% if course %}
{% if course.reference %}

/* Speed and turn of the reference at its knots, {{ course.knot_ticks }} ticks apart, linear between. */
{% for column, knots in course.knots.items() %}
static const real knots_{{ column }}[] = {
{% for row in knots|batch(8) %}
    {{ row|map("real")|join(", ") }},
{% endfor %}
};
{% endfor %}

static real between(const real *knots, int tick)
{
    const int knot = tick / {{ course.knot_ticks }}, part = tick % {{ course.knot_ticks }};
    if (tick >= {{ course.reference.ticks }})
        return knots[{{ course.knots.v|length - 1 }}];
    return knots[knot] + (knots[knot + 1] - knots[knot]) * (real)part / {{ course.knot_ticks|real }};
}

static real wrapped(real angle)
{
    const real rest = REMAINDER(angle, R(6.283185307179586));
    return rest == R(-3.141592653589793) ? R(3.141592653589793) : rest;
}
{% endif %}

void {{ name }}_course_start({{ name }}_course *course)
{
    course->tick = -1;
{% if course.reference %}
{% for field in ["x", "y", "theta"] %}
    course->{{ field }} = {{ course.start[loop.index0]|real }};
{% endfor %}
    course->v = knots_v[0];
    course->omega = knots_omega[0];
{% endif %}
}

void {{ name }}_course_advance({{ name }}_course *course)
{
{% if course.reference %}
    if (course->tick >= 0 && course->tick < {{ course.reference.ticks }}) {
        const real v = between(knots_v, course->tick + 1), omega = between(knots_omega, course->tick + 1);
        const real turn = R(0.5) * {{ tick_s|real }} * (course->omega + omega);
        const real heading = course->theta + R(0.5) * turn;
        course->x += {{ tick_s|real }} * (R(0.5) * (course->v + v)) * COS(heading);
        course->y += {{ tick_s|real }} * (R(0.5) * (course->v + v)) * SIN(heading);
        course->theta += turn;
        course->v = v;
        course->omega = omega;
    }
{% endif %}
    course->tick++;
}

void {{ name }}_observe(const {{ name }}_course *course, real x, real y, real theta, real *observation)
{
{% if course.reference %}
    /* The reference's pose from the rover: m ahead, m to the left, rad to the left. */
    const real dx = course->x - x, dy = course->y - y;
    const real cosine = COS(theta), sine = SIN(theta);
    real turned = wrapped(course->theta) - theta;
    if (turned > R(3.141592653589793))
        turned -= R(6.283185307179586);
    else if (turned <= R(-3.141592653589793))
        turned += R(6.283185307179586);
    (void)dx, (void)dy, (void)cosine, (void)sine, (void)turned; /* a policy may observe only some of them */
{% endif %}
    (void)course, (void)x, (void)y, (void)theta;
{% for expression in course.observation %}
    observation[{{ loop.index0 }}] = {{ expression }};
{% endfor %}
}
{% endif %}
