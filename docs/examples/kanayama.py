"""The tracking law of Kanayama et al. (1990) as a policy in Python, to compare a circuit with.

    rover-ncp eval docs.examples.kanayama:Kanayama --trials 20 --randomize full

The law observes the pose and the velocity of the reference relative to the rover, as the shipped circuit
``course`` does. The circuit's search tuned the gains and the least commands on the circuit's trials and cost.
"""

import math

GAIN_X, GAIN_Y, GAIN_THETA = 0.4592, 16.54, 18.83
MIN_V, MIN_OMEGA = 0.007335, 0.1451  # smaller commands are zero: a parked rover stands, whatever the noise
MAX_V, MAX_OMEGA = 0.24, 0.36  # the limits of the circuit's commands, in m/s and rad/s


class Kanayama:
    """Feed the reference's velocity forward and correct the errors of the pose (equation 8)."""

    signals = ("longitudinal", "lateral", "heading", "speed", "turn")

    def __call__(self, observation):
        """Return v (m/s) and omega (rad/s)."""
        ahead, left, heading, speed, turn = observation
        v = speed * math.cos(heading) + GAIN_X * ahead
        omega = turn + speed * (GAIN_Y * left + GAIN_THETA * math.sin(heading))
        return limited(v, MIN_V, MAX_V), limited(omega, MIN_OMEGA, MAX_OMEGA)


def limited(value, least, most):
    """Return zero for a value below the least size, else the value within ± the most."""
    return 0.0 if abs(value) < least else min(max(value, -most), most)
