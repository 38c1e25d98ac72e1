"""One drive: control loop, controller, safety monitor, link to the bridge."""
