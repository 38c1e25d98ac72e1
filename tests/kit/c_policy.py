"""An exported policy, compiled with gcc and run in this process."""

import ctypes
import subprocess

import numpy as np

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-ffp-contract=off"]


def compile_c(files, folder, target, *options):
    """Write sources and compile them; a warning is an error. Return the path of the result."""
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        (folder / file).write_text(text)
    sources = [file for file in files if file.endswith(".c")]
    command = ["gcc", *STRICT, *options, "-o", target, *sources, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return folder / target


class CPolicy:
    """What `Runner` is, on the C code; ``real`` is the type that it was compiled for."""

    def __init__(self, policy, library, name, real=ctypes.c_double):
        self.policy, self._name, self._real = policy, name, real
        self._library = ctypes.CDLL(str(library))
        self._state = (real * policy.circuit.size)()
        self.reset()

    @property
    def potentials(self):
        return np.array(self._state, np.float64)

    def reset(self):
        getattr(self._library, f"{self._name}_reset")(self._state)

    def try_tick(self, observation):
        """Return what the function returned, and the command."""
        seen = (self._real * len(self.policy.sensing.inputs))(*observation)
        command = (self._real * len(self.policy.motors.outputs))()
        code = getattr(self._library, f"{self._name}_tick")(self._state, seen, command)
        return code, tuple(command)

    def tick(self, observation):
        code, command = self.try_tick(observation)
        assert code == 0
        return command


class CCourse:
    """The exported course of a policy, as double."""

    def __init__(self, policy, library, name):
        class State(ctypes.Structure):
            _fields_ = [("tick", ctypes.c_int), *((field, ctypes.c_double) for field in "xytvw")]

        self._library, self._name, self._state = ctypes.CDLL(str(library)), name, State()
        self._seen = (ctypes.c_double * len(policy.sensing.inputs))()
        getattr(self._library, f"{name}_course_start")(ctypes.byref(self._state))

    def advance(self):
        getattr(self._library, f"{self._name}_course_advance")(ctypes.byref(self._state))

    def observe(self, pose):
        numbers = [ctypes.c_double(value) for value in pose]
        getattr(self._library, f"{self._name}_observe")(ctypes.byref(self._state), *numbers, self._seen)
        return tuple(self._seen)
