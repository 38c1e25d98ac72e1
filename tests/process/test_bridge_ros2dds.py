"""The tokens that zenoh-bridge-ros2dds looks for, as keys and on a real bridge."""

from kit.bridge_bench import Rig, client

from bridge.ros2.discovery import bridge_token, topic_token
from rover_ncp.wire.key_table import KEYS, Kind, Role


def test_tokens_have_the_form_that_the_ros_bridge_reads():
    # The examples of zenoh-plugin-ros2dds' own source and issue 213.
    assert bridge_token("abc") == "@/abc/@ros2_lv"
    assert (
        topic_token("abc", "odom", "nav_msgs/msg/Odometry", published=True)
        == "@/abc/@ros2_lv/MP/odom/nav_msgs§msg§Odometry/:1:0:0,10"
    )
    assert (
        topic_token("abc", "bot1/cmd_vel", "geometry_msgs/msg/TwistStamped", published=False)
        == "@/abc/@ros2_lv/MS/bot1§cmd_vel/geometry_msgs§msg§TwistStamped/:1:0:0,10"
    )
    assert topic_token("abc", "tf_static", "tf2_msgs/msg/TFMessage", published=True, latched=True).endswith(
        "§TFMessage/:1:1:0,1"
    )


def test_every_topic_of_a_bridge_shows_itself_and_cmd_vel_has_no_type(tmp_path):
    """With a token of TwistStamped, zenoh-bridge-ros2dds would pass on no Twist."""
    with Rig(tmp_path, bridge=["--namespace", "bot1"]) as rig:
        session = client(rig.locator)
        try:
            replies = session.liveliness().get("@/*/@ros2_lv/**", timeout=2.0)
            found = {str(reply.ok.key_expr).split("@ros2_lv", 1)[1] for reply in replies}
        finally:
            session.close()
    ours = [row for row in KEYS if row.kind is Kind.MESSAGE and row.senders == {Role.BRIDGE}]
    wanted = {("MP", row.name) for row in ours}
    assert "" in found
    topics = [token.split("/")[1:3] for token in found if token]
    assert {(kind, key.replace("§", "/")) for kind, key in topics} == {
        (kind, f"bot1/{name}") for kind, name in wanted
    }
