"""Bridge to a device: wire protocol, simulated twin, safety limits."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.bridge.calibration import Calibration as Calibration
    from maglev_mj.bridge.fault import DeviceFault as DeviceFault
    from maglev_mj.bridge.fault import HandshakeError as HandshakeError
    from maglev_mj.bridge.remote import RemotePlant as RemotePlant
    from maglev_mj.bridge.safety import HostLimits as HostLimits
    from maglev_mj.bridge.safety import Limits as Limits
    from maglev_mj.bridge.twin import Twin as Twin
    from maglev_mj.bridge.twin import TwinParameters as TwinParameters
    from maglev_mj.bridge.wire import Fault as Fault
    from maglev_mj.bridge.wire import State as State
    from maglev_mj.net.udp import open_link as open_link
else:
    _HOMES = {
        "calibration": "Calibration",
        "fault": "DeviceFault HandshakeError",
        "remote": "RemotePlant",
        "safety": "HostLimits Limits",
        "twin": "Twin TwinParameters",
        "wire": "Fault State",
        ".net.udp": "open_link",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
