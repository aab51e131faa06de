"""Conformance tests of a device against docs/reference/protocol.md.

Checks without flight run first and send at most half the hover currents; then come checks in flight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.conformance import flights  # noqa: F401, registers CHECKS, those of `protocol` first
from maglev_mj.bridge.conformance.tester import CHECKS, CheckResult, Tester
from maglev_mj.bridge.links import Link
from maglev_mj.bridge.wire import Operation, State, fault_names
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.keywords import checked

__all__ = ["CheckResult", "checks", "conform"]


def checks() -> dict[str, str]:
    """Return the expected behaviour of each check, by name."""
    return {name: check.expected for name, check in CHECKS.items()}


@checked
def conform(
    links: Sequence[Link],
    calibration: Calibration | None = None,
    key: bytes | None = None,
    *,
    flight: bool = True,
    only: Iterable[str] | None = None,
    tell: Callable[[CheckResult], object] = lambda result: None,
) -> list[CheckResult]:
    """Test a device and leave it INACTIVE, without a session.

    Args:
        links: Links to the device, from one or two host addresses; left open.
        calibration: Calibration of the device (default nominal).
        key: Authentication key of the frames.
        flight: Include checks in flight, which drop the flotor onto its stops several times.
        only: Names of the checks to run (default all).
        tell: Function called with each result.

    Raises:
        HandshakeError: If no device answers, or it refuses this host.
        PlantError: If a fault is latched.
        LinkError: If a link has failed.

    Example:
        >>> from maglev_mj import Twin, TwinParameters, conform
        >>> from maglev_mj.bridge.twin.simulated_links import VirtualLink
        >>> from maglev_mj.bridge.conformance import checks
        >>> results = conform([VirtualLink(Twin(TwinParameters()))], flight=False, only=list(checks())[:1])
        >>> [result.name for result in results if result.passed is False]
        []
    """
    if not links:
        raise ParameterError("links must be one or two links, as open_link returns (got none)")
    tester = Tester(links, calibration or Calibration.nominal(), key)
    tester.join()
    if tester.welcome.state == State.FAULT:
        tester.ask(Operation.BYE)
        raise PlantError(f"the device has latched {fault_names(tester.welcome.faults)}: fix the cause, then reset it")
    results: list[CheckResult] = []
    try:
        for name in CHECKS if only is None else only:
            results.append(CHECKS[name].result(name, tester, flight))
            tell(results[-1])
    finally:
        tester.release()
    return results
