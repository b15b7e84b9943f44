# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a driver has to tell of itself, as names and values."""

from __future__ import annotations

from stri_mapping.lms.driver import Driver
from stri_mapping.lms.status import describe_status


def report_values(driver: Driver) -> dict[str, object]:
    """Return the state of a driver by the keys of REP-138, and some of its own."""
    settings, stamper, counts = driver.settings, driver.stamper, driver.counts
    values: dict[str, object] = {
        'Serial Port': settings.serial_port, 'Serial Baud': settings.serial_baud,
        'Vendor Name': 'SICK', 'User Time Offset': settings.time_offset,
        'Scans': stamper.dated, 'Lost scans': stamper.lost,
        'Withheld scans': stamper.withheld, 'Reconnects': driver.reconnects,
        'CRC errors': counts.crc_errors, 'Bytes of noise': counts.noise_bytes,
        'Mirror turn (ms)': f'{stamper.clock.turn_ns * 1e-6:.5f}',
        'Arrival jitter (ms)': f'{stamper.clock.arrival_jitter.rms * 1e-6:.3f}',
        'Stamp jitter (ms)': f'{stamper.clock.fit_jitter.rms * 1e-6:.3f}',
        'Status': describe_status(driver.status)}
    if driver.identity is not None and driver.stream is not None:
        identity, stream = driver.identity, driver.stream
        latency = stamper.computed_latency(stream.turns, stream.variant.first)
        values |= {
            'Product Name': identity.product, 'Stream': f'{stream.kind}, {stream.variant}',
            'Firmware Version': identity.status.firmware.strip(),
            'Device ID': identity.status.serial_number.strip(),
            'Computed Latency': f'{latency:.6f}',
            'Window pollution': f'{100.0 * identity.status.window_pollution:.0f} %',
            'Error list': '; '.join(identity.errors.texts) or 'empty'}
    return values
