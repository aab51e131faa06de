"""The bridge to a device: its wire, a twin to try it on, and what keeps both whole."""

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.bridge.fault import DeviceFault, HandshakeError
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import Envelope, Limits
from maglev_mj.bridge.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.net.udp import open_link

__all__ = [
    "Calibration",
    "DeviceFault",
    "Envelope",
    "Fault",
    "HandshakeError",
    "Limits",
    "RemotePlant",
    "State",
    "Twin",
    "TwinParameters",
    "open_link",
]
