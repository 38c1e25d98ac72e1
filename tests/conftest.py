"""What holds for all tests."""

import signal

from hypothesis import Phase, settings

# A shell that starts the tests in the background has them ignore Ctrl-C, and so would every process that they
# start and then interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

# How long an example takes says more about the machine's other work than about the code.
settings.register_profile("rover-ncp", deadline=None)
settings.load_profile("rover-ncp")
# For mutants (tests/mutate_gate.py) it is enough to die: nobody looks at the smallest example.
settings.register_profile("mutants", deadline=None, database=None, phases=[Phase.explicit, Phase.generate])
