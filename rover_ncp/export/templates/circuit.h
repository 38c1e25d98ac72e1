/* The policy $title as C: from an observation to a command.

   Made by rover-ncp $version. C99; no allocation, no static state. Define ROVER_NCP_FLOAT for float
   instead of double.

       ${name}_state state;
       ${name}_reset(&state);
       every $tick_s s: ${name}_tick(&state, observation, command);

   observation: $inputs
   command: $outputs
   (m, rad, m/s and rad/s) */
#ifndef ROVER_NCP_${guard}_H
#define ROVER_NCP_${guard}_H

#ifdef __cplusplus
extern "C" {
#endif

#ifdef ROVER_NCP_FLOAT
typedef float ${name}_real;
#else
typedef double ${name}_real;
#endif

enum { ${guard}_INPUTS = $input_count, ${guard}_OUTPUTS = $output_count, ${guard}_NEURONS = $neuron_count };

/* Potentials in mV of $neurons. */
typedef struct {
    ${name}_real potential[${guard}_NEURONS];
} ${name}_state;

/* Put every neuron at rest. */
void ${name}_reset(${name}_state *state);

/* Run one control tick. Returns 0; or -1 if a number of the observation is not finite. The state is then
   unchanged and the command 0. */
int ${name}_tick(${name}_state *state, const ${name}_real *observation, ${name}_real *command);

#ifdef __cplusplus
}
#endif

#endif
