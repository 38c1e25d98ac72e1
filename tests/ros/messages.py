"""ROS's own serialiser: random messages with their values and hashes, or the values of messages given to it.

``random N TYPE ...`` prints a JSON object for each message: type, the type's hash, bytes, values. ``read``
reads lines of a type and bytes in hexadecimal, and prints type, values and the length of the bytes that ROS
writes. The bytes themselves may differ: FastCDR leaves bytes of padding as they are in memory.
"""

import json
import random
import re
import sys
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message
from wires import message_class

BOUNDS = {f"{sign}int{bits}": bits for sign in ("", "u") for bits in (8, 16, 32, 64)}
SIMPLE = {
    "float": lambda rng: rng.randrange(-(2**24), 2**24) / 2**10,
    "double": lambda rng: rng.uniform(-1e6, 1e6),
    "boolean": lambda rng: rng.random() < 0.5,
    "octet": lambda rng: bytes([rng.randrange(128)]),
    "string": lambda rng: "".join(rng.choices("aZ_/09 äπ", k=rng.randrange(12))),
}


def type_hash(ros_type):
    """Return the hash that ROS's package of this type has."""
    package, _, name = ros_type.split("/")
    text = (Path(sys.prefix) / "share" / package / "msg" / f"{name}.json").read_text()
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(text)["type_hashes"]}
    return hashes[ros_type]


def values(message):
    """Return a message as plain values."""
    if isinstance(message, bytes):  # a byte
        return message[0]
    if hasattr(message, "get_fields_and_field_types"):
        return {name: values(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if isinstance(message, (str, bool, int, float)):
        return message
    return (
        [values(part) for part in message.tolist()]
        if hasattr(message, "tolist")
        else list(map(values, message))
    )


def chosen(kind, rng):
    """Return a random value of a field's type."""
    if many := re.fullmatch(r"sequence<(.+?)>|(.+)\[(\d+)\]", kind):
        # rosbags pads after the length of an empty list of float64, ROS does not. Only rover/neurons has
        # such a list, which is never empty.
        count = int(many[3]) if many[3] else rng.randrange(1 if many[1] == "double" else 0, 5)
        return [chosen(many[1] or many[2], rng) for _ in range(count)]
    if kind in BOUNDS:
        bits, signed = BOUNDS[kind], kind[0] == "i"
        return rng.randrange(-(2 ** (bits - 1)) if signed else 0, 2 ** (bits - 1) if signed else 2**bits)
    if kind in SIMPLE:
        return SIMPLE[kind](rng)
    message = message_class(kind.replace("/", "/msg/"))()
    for name, field in message.get_fields_and_field_types().items():
        setattr(message, name, chosen(field, rng))
    return message


def main():
    if sys.argv[1] == "random":
        rng = random.Random(1)
        for ros_type in sys.argv[3:]:
            for _ in range(int(sys.argv[2])):
                message = chosen(ros_type.replace("/msg/", "/"), rng)
                found = {"type": ros_type, "hash": type_hash(ros_type), "values": values(message)}
                print(json.dumps(found | {"bytes": serialize_message(message).hex()}))
    for line in sys.stdin if sys.argv[1] == "read" else ():
        ros_type, text = line.split()
        message = deserialize_message(bytes.fromhex(text), message_class(ros_type))
        length = len(serialize_message(message))
        print(json.dumps({"type": ros_type, "length": length, "values": values(message)}))


if __name__ == "__main__":
    main()
