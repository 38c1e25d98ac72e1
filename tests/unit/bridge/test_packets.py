"""A base's packets: recorded ones first, then cut off anywhere, then garbage."""

from hypothesis import given
from hypothesis import strategies as st
from kit.arcos_captures import CAPTURES, VECTORS

from bridge.pioneer.framing import Decoder
from bridge.pioneer.packets import SIP_KINDS, ConfigPac, GyroPac, Sip


def recorded(*kinds):
    found = set()
    for capture in CAPTURES:
        decoder = Decoder()
        for t, data in capture.chunks("r2c"):
            found |= {packet for packet in decoder.feed(data, t) if packet.kind in kinds}
    return sorted(found)


def has_its_sonars(packet):
    """AMRISim announces 16 sonars and sends none in the SIP right after SONAR 1: a frame of 41 bytes."""
    return len(packet.payload) != 35 or packet.payload[18] == 0


def test_recorded_sips_encode_back_to_themselves_and_announced_sonars_that_are_not_there_give_no_readings():
    sips = recorded(*SIP_KINDS)
    sound = [packet for packet in sips if has_its_sonars(packet)]
    assert len(sips) > len(sound) > 500
    for packet in sips:
        sip = Sip.decode(packet)
        assert sip.encode() == packet if packet in sound else (sip.sonar, sip.rotvel) == ((), None)


def test_a_real_configuration_beyond_127_bytes():
    data = bytes.fromhex(VECTORS["real_P3DX-SH_CONFIGpac_prefix"]["hex"])
    assert data[2] == 137
    config = ConfigPac.decode(data[4:])
    assert (config.subtype, config.serial_number, config.name) == ("p3dx-sh", "GJC_3156", "FAPESP_3156")
    assert (config.sip_cycle, config.rot_vel_top, config.pwm_max) == (100, 360, 500)


def test_a_real_pioneer_2_sip_ends_early_and_says_so():
    (packet,) = Decoder().feed(bytes.fromhex(VECTORS["real_P2_SIP"]["hex"]))
    sip = Sip.decode(packet)
    assert sip.battery_dv == 144
    assert sip.sonar == ((4, 32000), (7, 32000))
    assert (sip.stall_left, sip.stall_right) == (0xFE, 0xFE)
    assert sip.digout is not None
    assert (sip.battery_x10, sip.rotvel, sip.faults) == (None, None, None)
    assert sip.encode() == packet


@given(st.lists(st.tuples(st.integers(0, 1023), st.integers(0, 255)), max_size=8), st.integers(0, 30))
def test_a_gyropac_comes_back_and_cut_off_it_holds_its_whole_readings(readings, cut):
    packet = GyroPac(tuple(readings)).encode()
    assert GyroPac.decode(packet.payload) == GyroPac(tuple(readings))
    rest = packet.payload[: max(len(packet.payload) - cut, 0)]
    assert GyroPac.decode(rest).readings == tuple(readings)[: max(len(rest) - 1, 0) // 3]
    assert (GyroPac(tuple(readings)).rate is None) == (not readings)
