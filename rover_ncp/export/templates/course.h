/* The course $course for the policy $title as C: from the rover's pose to an observation.

   Made by rover-ncp $version. A drive, from rest at its start:

       ${name}_reset(&state);
       ${name}_course_start(&course);
       ${name}_observe(&course, x, y, theta, observation);
       ${name}_tick(&state, observation, command);             warm-up: discard this command
       every $tick_s s, ${guard}_COURSE_TICKS times:
           ${name}_course_advance(&course);
           ${name}_observe(&course, x, y, theta, observation);
           ${name}_tick(&state, observation, command);

   The pose is that of the base in the course's frame: x, y in m, theta in rad within (-pi, pi]. */
#ifndef ROVER_NCP_${guard}_COURSE_H
#define ROVER_NCP_${guard}_COURSE_H

#include "${name}.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { ${guard}_COURSE_TICKS = $ticks };

/* The tick, -1 for the warm-up$fields_are. */
typedef struct {
    int tick;$fields
} ${name}_course;

void ${name}_course_start(${name}_course *course);
void ${name}_course_advance(${name}_course *course);

/* Fill in an observation, the input of ${name}_tick. */
void ${name}_observe(const ${name}_course *course, ${name}_real x, ${name}_real y, ${name}_real theta,
                     ${name}_real *observation);

#ifdef __cplusplus
}
#endif

#endif
