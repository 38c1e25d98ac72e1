"""A circuit explained by what it does without its parts: knock-outs, sensitivities, stories of a training."""
