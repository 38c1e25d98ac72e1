"""A Zenoh session with settings of its own."""

import json

import zenoh


def open_session(mode, settings):
    """Open a session with these settings, by their paths; it looks for nothing on the network."""
    config = zenoh.Config()
    alone = {"mode": mode, "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}
    for path, value in {**alone, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)
