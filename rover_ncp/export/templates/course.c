/* The course $course for the policy $title: see ${name}_course.h. */
#include <math.h>

#include "${name}_course.h"

typedef ${name}_real real;

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

/* Speed and turn of the reference at its knots, $knot_ticks ticks apart, linear between. */
static const real knots_v[] = {
$knots_v
};
static const real knots_omega[] = {
$knots_omega
};

static real between(const real *knots, int tick)
{
    const int knot = tick / $knot_ticks, part = tick % $knot_ticks;
    if (tick >= $reference_ticks)
        return knots[$last_knot];
    return knots[knot] + (knots[knot + 1] - knots[knot]) * (real)part / R($knot_ticks.0);
}

static real wrapped(real angle)
{
    const real rest = REMAINDER(angle, R($tau));
    return rest == -R($pi) ? R($pi) : rest;
}

void ${name}_course_start(${name}_course *course)
{
    course->tick = -1;
    course->x = R($x);
    course->y = R($y);
    course->theta = R($theta);
    course->v = knots_v[0];
    course->omega = knots_omega[0];
}

void ${name}_course_advance(${name}_course *course)
{
    if (course->tick >= 0 && course->tick < $reference_ticks) {
        const real v = between(knots_v, course->tick + 1), omega = between(knots_omega, course->tick + 1);
        const real turn = R(0.5) * R($tick_s) * (course->omega + omega);
        const real heading = course->theta + R(0.5) * turn;
        course->x += R($tick_s) * (R(0.5) * (course->v + v)) * COS(heading);
        course->y += R($tick_s) * (R(0.5) * (course->v + v)) * SIN(heading);
        course->theta += turn;
        course->v = v;
        course->omega = omega;
    }
    course->tick++;
}

/* The reference's pose is seen from the rover: m ahead, m to the left, rad to the left. */
void ${name}_observe(const ${name}_course *course, real x, real y, real theta, real *observation)
{
    const real dx = course->x - x, dy = course->y - y;
    const real cosine = COS(theta), sine = SIN(theta);
    real turned = wrapped(course->theta) - theta;
    if (turned > R($pi))
        turned -= R($tau);
    else if (turned <= -R($pi))
        turned += R($tau);
    (void)dx, (void)dy, (void)cosine, (void)sine, (void)turned; /* a policy may see only some of them */
$observation
}
