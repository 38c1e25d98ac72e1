"""The ``park`` command: train, drive and report in one go."""
