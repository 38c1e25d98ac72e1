"""A node that publishes a topic, prints its messages as JSON, or prints what is there, as ``ros2 topic``."""

import argparse
import json
import time

from messages import values
from wires import WIRES, header, input_lines


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("what", choices=("pub", "echo"))
    add("topic", nargs="?")
    add("type", nargs="?")
    add("fields", nargs="?", type=json.loads, help="a message; the stamp of its header becomes the present")
    add("--by", choices=WIRES, default="rclpy")
    add("--router", default="")
    add("--name", default="tester")
    add("--rate", type=float, default=10.0)
    given = parser.parse_args()
    wire = WIRES[given.by](given.name, "", given.router)
    publish = None
    if given.what == "pub":
        publish = wire.publisher(given.topic, given.type)
    elif given.what == "echo":
        show = lambda message: print(json.dumps(values(message)), flush=True)  # noqa: E731
        wire.subscribe(given.topic, given.type, show)
    while input_lines() is not None:
        if publish is not None:
            if "header" in given.fields:
                given.fields["header"] = header(time.time(), given.fields["header"]["frame_id"])
            publish(given.fields)
            print("{}", flush=True)
        wire.spin(1.0 / given.rate)
    wire.close()


if __name__ == "__main__":
    main()
