"""A policy in Python: it follows the course's reference. ``python own_policy.py`` drives the simulator."""

import gymnasium
import numpy as np

SIGNALS = ("longitudinal", "lateral", "heading", "speed", "turn")
STEP = np.array([0.05, 0.1])  # largest change of v and omega in a tick


class Follow:
    """Feed the reference's motion forward, correct the errors, and change commands smoothly."""

    signals = SIGNALS

    def __init__(self):
        self.last = np.zeros(2)

    def reset(self):
        """Begin a drive."""
        self.last = np.zeros(2)

    def __call__(self, observation):
        """Return v (m/s) and omega (rad/s)."""
        longitudinal, lateral, heading, speed, turn = observation
        v = speed * np.cos(heading) + 0.5 * longitudinal
        omega = turn + speed * (16.0 * lateral + 12.0 * np.sin(heading))
        if speed == 0.0 and abs(v) < 0.02:
            v = 0.0
        self.last = self.last + np.clip((v, omega) - self.last, -STEP, STEP)
        return self.last


def main():
    """Drive the parking course once."""
    policy = Follow()
    env = gymnasium.make("sim.world.env:rover_ncp/RoverParking-v0", signals=SIGNALS)
    observation, info = env.reset()
    total, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        total, over = total + reward, terminated or truncated
    env.close()
    print(f"return {total:.3f}; {info}")


if __name__ == "__main__":
    main()
