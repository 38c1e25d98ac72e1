"""Zenoh sessions with settings of their own."""

import itertools
import json
import threading
from contextlib import contextmanager

import zenoh


def open_session(mode, settings):
    """Open a session with these settings, by their paths; it looks for nothing on the network."""
    config = zenoh.Config()
    alone = {"mode": mode, "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}
    for path, value in {**alone, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def open_router(protocol="tcp", **settings):
    """Open a router on a port that the system picks; return it and its locator."""
    own = {"listen/endpoints": [f"{protocol}/127.0.0.1:0"], "adminspace/enabled": True, "scouting/delay": 0}
    session = open_session("router", own | settings)
    (reply,) = session.get(f"@/{session.info.zid()}/router", timeout=2.0)
    return session, json.loads(reply.ok.payload.to_string())["locators"][0]


@contextmanager
def repeating(session, period_s):
    """Yield a function that has another called with 0, 1, ... by a thread; in the end close the session."""
    ended, threads = threading.Event(), []

    def start(put):
        def run():
            for number in itertools.count():
                if ended.wait(period_s):
                    return
                put(number)

        threads.append(threading.Thread(target=run))
        threads[-1].start()

    try:
        yield start
    finally:
        ended.set()
        for thread in threads:
            thread.join()
        session.close()
