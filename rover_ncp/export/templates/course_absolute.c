/* The course $course for the policy $title: see ${name}_course.h. */
#include "${name}_course.h"

typedef ${name}_real real;

#ifdef ROVER_NCP_FLOAT
#define R(number) number##f
#else
#define R(number) number
#endif

void ${name}_course_start(${name}_course *course) { course->tick = -1; }

void ${name}_course_advance(${name}_course *course) { course->tick++; }

void ${name}_observe(const ${name}_course *course, real x, real y, real theta, real *observation)
{
    (void)course, (void)x, (void)y, (void)theta;
$observation
}
