"""A node that publishes a topic, prints its messages as JSON, or prints what is there, as ``ros2 topic``."""

import argparse
import json
import time

from wires import WIRES, header, input_open


def values(message):
    """Return a message of simple fields and messages as plain values; lists are left out."""
    if hasattr(message, "get_fields_and_field_types"):
        fields = message.get_fields_and_field_types()
        return {name: values(getattr(message, name)) for name in fields}
    return message if isinstance(message, (str, bool, int, float)) else None


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
    while input_open():
        if publish is not None:
            if "header" in given.fields:
                given.fields["header"] = header(time.time(), given.fields["header"]["frame_id"])
            publish(given.fields)
            print("{}", flush=True)
        wire.spin(1.0 / given.rate)
    wire.close()


if __name__ == "__main__":
    main()
