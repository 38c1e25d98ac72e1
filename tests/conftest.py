"""What holds for all tests."""

from hypothesis import Phase, settings

# How long an example takes says more about the machine's other work than about the code.
settings.register_profile("rover-ncp", deadline=None)
settings.load_profile("rover-ncp")
# For mutants (tests/mutate_gate.py) it is enough to die: nobody looks at the smallest example.
settings.register_profile("mutants", deadline=None, database=None, phases=[Phase.explicit, Phase.generate])
