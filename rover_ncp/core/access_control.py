"""Access control of a bridge over Zenoh: the rights of each role, made from the table of keys.

Zenoh matches rules by inclusion only, so nothing but a deny by default with exact keys holds: with an allow
by default, a message on ``rover/*`` would slip past a rule that denies ``rover/motors``. Rules apply at the
links of the bridge's router; what its own session does is not filtered.
"""

from typing import Any

from rover_ncp.core.key_table import KEYS, KeySpec, Kind, Role, key

# (flow seen from the bridge's router, kinds of Zenoh messages) for a peer that sends, and one that receives.
# A peer detects a listener only where the listener's declaration may leave the router. That is how a
# driver checks whether it may drive before it tries.
_SENDS = {
    Kind.MESSAGE: (("ingress", ("put",)), ("egress", ("declare_subscriber",))),
    Kind.QUERYABLE: (("ingress", ("query",)), ("egress", ("reply", "declare_queryable"))),
    Kind.TOKEN: (("ingress", ("liveliness_token",)),),
}
_RECEIVES = {
    Kind.MESSAGE: (("egress", ("put",)), ("ingress", ("declare_subscriber",))),
    Kind.QUERYABLE: (),  # only the bridge answers, and it is no peer of its own router
    Kind.TOKEN: (
        ("egress", ("liveliness_token",)),
        ("ingress", ("declare_liveliness_subscriber", "liveliness_query")),
    ),
}


def access_control(roles: tuple[Role, ...], namespace: str = "") -> dict[str, Any]:
    """Return Zenoh's ``access_control``: each role, named as user and in its certificate, gets its rows.

    Raises UsageError for a namespace that is no key.
    """
    policies = []
    rules = []
    for role in roles:
        of_role = list(_rules(role, namespace))
        rules += of_role
        policies.append({"rules": [rule["id"] for rule in of_role], "subjects": [role.value]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [
            {"id": role.value, "cert_common_names": [role.value], "usernames": [role.value]} for role in roles
        ],
        "policies": policies,
    }


def _rules(role: Role, namespace: str) -> list[dict[str, Any]]:
    allowed: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for row in KEYS:
        for flow_and_messages in _rights(role, row):
            allowed.setdefault(flow_and_messages, []).append(key(namespace, row.name))
    return [
        {
            "id": f"{role.value}-{flow}-{messages[0].replace('_', '-')}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": key_exprs,
        }
        for (flow, messages), key_exprs in allowed.items()
    ]


def _rights(role: Role, row: KeySpec) -> list[tuple[str, tuple[str, ...]]]:
    rights: list[tuple[str, tuple[str, ...]]] = []
    if role in row.senders:
        rights += _SENDS[row.kind]
    if role in row.receivers:
        rights += _RECEIVES[row.kind]
    return rights
