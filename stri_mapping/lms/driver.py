# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A scanner as a source of timed scans that comes back by itself whatever happens to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import logging
from pathlib import Path
import time

from stri_mapping.errors import LmsError
from stri_mapping.lms.answers import decode_answer
from stri_mapping.lms.capture import CaptureEndError, open_capture
from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.device import CancelledError, Device, POWER_ON_RATE, TRIES
from stri_mapping.lms.identity import Identity
from stri_mapping.lms.line import BYTE_BITS, Line
from stri_mapping.lms.measuring import measuring_mode, MeasuringMode
from stri_mapping.lms.parser import LineCounts, Received
from stri_mapping.lms.port import find_again, open_port, usb_identity, UsbIdentity
from stri_mapping.lms.requests import RATES, ReadStatus
from stri_mapping.lms.settings import LmsSettings
from stri_mapping.lms.stamps import Stamper, TimedScan
from stri_mapping.lms.status import Status
from stri_mapping.lms.stream import rate_table, Stream

# A stream counts as lost after so many seconds, and scan periods, in which nothing came, or in
# which came as many bytes as the line carries in that time, and no scan.
SILENT, SILENT_PERIODS = 0.4, 4.0
# Seconds between attempts to get a scanner back: at first, and at most.
BACK_OFF = (0.05, 0.25)
# Of the attempts, every so many tries all rates; the others only those that a scanner has which
# was left streaming, or which has lost its power.
ALL_RATES_EVERY = 4
# Times that one process writes a scanner's configuration at most.
MOST_WRITES = 10
# Metres under which a range of all that can be sent is short for a street.
SHORT = 10.0
SHORT_HINT = ': "unit: cm" gives 80 m, measuring_mode 4 or 6 in mm 16 or 32 m'
logger = logging.getLogger(__name__)


class Driver:
    """
    Streams timed scans of one scanner, and gets the stream back when it breaks.

    Parameters
    ----------
    settings
        What is wanted.
    cancelled
        Asked during all waiting; once it returns True, everything is given up.

    Attributes
    ----------
    identity
        Who the scanner is; None until it was first found.
    stream
        What it is asked for; None likewise.
    state, streaming
        What is going on, in words, and whether scans are coming.
    status
        Status byte of the newest scan.
    stamper, counts
        Figures of the stamps and of the line.
    reconnects
        How often the stream was got back.

    """

    def __init__(
        self, settings: LmsSettings, cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        """Open nothing yet."""
        self.settings = settings
        self.identity: Identity | None = None
        self.stream: Stream | None = None
        self.state, self.streaming = 'not connected', False
        self.stamper = Stamper(settings.latency, settings.time_offset)
        self.counts = LineCounts()
        self.reconnects = 0
        self._cancelled = cancelled
        self._device: Device | None = None
        self._usb: UsbIdentity | None = None
        self._mode: MeasuringMode | None = None
        self._waited = 0.0                      # seconds in which nothing came, since a scan
        self._bytes = 0                         # bytes when the last scan came
        self._noise = 0                         # noise bytes and CRC errors when it came
        self._patience, self._stride = 0.0, 1
        self._writes = 0                        # of the configuration
        self.status = 0x10

    def connect(self, rates: Sequence[int] = (), rounds: int = TRIES) -> None:
        """
        Open the port, find the scanner and set it up; it does not stream yet.

        Parameters
        ----------
        rates
            Line rates to look for it at; by default the operating one, then all others.
        rounds
            How often to try all of them.

        Raises
        ------
        LmsError
            Saying what is wrong and what to try.

        """
        self.close()
        wanted = self.settings.serial_baud
        name = find_again(self.settings.serial_port, self._usb)
        self._device = Device(open_line(name, self.counts), self._cancelled)
        try:
            # twice, since a scanner can miss a request: looking elsewhere takes longer
            status = self._device.find(
                rates or (wanted, wanted, *(r for r in RATES if r != wanted)), rounds)
            self._set_up(self._device, status)
        except CancelledError:
            raise                           # the port is still needed to leave the scanner well
        except LmsError:
            self.close()
            raise
        self._usb = usb_identity(name) or self._usb

    def _set_up(self, device: Device, status: Status) -> None:
        settings = self.settings
        identity = device.identity(status)
        stream = settings.wanted_stream(identity.model)
        configuration = self._configured(device, identity.configuration)
        self._mode = measuring_mode(configuration.measuring_mode)
        changed = device.set_variant(stream.variant, status)
        # last: requests are heard best at the low rates, at which bytes need no pacing
        present = device.set_rate(settings.serial_baud)
        if present is None:
            present = device.ask(ReadStatus(), Status) if changed else status
        identity = replace(identity, status=present, configuration=configuration)
        rate, indices = device.line.rate or settings.serial_baud, configuration.indices
        self._stride = stream.stride(rate, indices)
        self._patience = max(SILENT, SILENT_PERIODS / stream.frequency(rate, indices))
        if self.identity is None:
            self._introduce(identity, stream, rate, indices)
            reach = self._mode.range_max(configuration.unit)
            logger.info('%s: ranges to %.4g m%s', device.line.name, reach,
                        SHORT_HINT if reach < SHORT else '')
        self.identity, self.stream, self.state = identity, stream, 'ready'

    def _configured(self, device: Device, present: Configuration) -> Configuration:
        """Have the scanner take the settings; return what is active."""
        wanted = self.settings.configuration(present)
        if wanted == present:
            return present
        if self._writes == MOST_WRITES:
            raise LmsError(f'{device.line.name}: the scanner loses its configuration: it is not '
                           'written again, because each time wears its memory')
        self._writes += 1
        logger.info('%s: writing the configuration: %s instead of %s', device.line.name,
                    wanted.block.hex(' '), present.block.hex(' '))
        return device.configure(wanted)

    def _introduce(self, identity: Identity, stream: Stream, rate: int, indices: bool) -> None:
        """Say which scanner it is, and what the line carries."""
        port = self.settings.serial_port
        logger.info('%s: %s', port, identity.name)
        logger.info('%s: %s of %s: %.3g Hz at %d Bd (%s)', port, stream.kind, stream.variant,
                    stream.frequency(rate, indices), rate, rate_table(stream, indices))
        for text in identity.errors.texts:
            logger.warning('%s: fault memory: %s', port, text)

    def start(self) -> None:
        """Let the scanner stream; raises LmsError."""
        if self._device is None:            # it was stopped while it was not there
            self.connect()
        assert self._device is not None and self.stream is not None
        self._device.start(self.stream)
        self.stamper.restart(self._stride)
        self._waited, self._bytes = 0.0, self.counts.bytes
        self.state, self.streaming = 'streaming', True

    def scans(self, timeout: float) -> list[TimedScan]:
        """
        Wait for scans.

        Parameters
        ----------
        timeout
            Seconds to wait for the first byte.

        Returns
        -------
        list
            Scans in the order of their stamps, all of them after those given out before.

        Raises
        ------
        LmsError
            If the stream is broken.

        """
        assert self._device is not None
        line, before = self._device.line, self.counts.bytes
        items = line.receive(timeout)
        found = [self._timed(item) for item in items if isinstance(item, Received)]
        # what this process slept over is not held against the scanner
        self._waited += timeout if self.counts.bytes == before else 0.0
        if self._waited > self._patience:
            raise LmsError(f'{line.name}: nothing came for {self._waited:.1f} s')
        garbled = self.counts.bytes - self._bytes
        if garbled > self._patience * max(line.rate, POWER_ON_RATE) / BYTE_BITS:
            raise LmsError(f'{line.name}: {garbled} bytes without an intact scan')
        return [scan for scan in found if scan is not None]

    def _timed(self, item: Received) -> TimedScan | None:
        assert self._mode is not None and self.stream is not None
        try:
            scan = self.stream.measured(decode_answer(item.telegram.payload), self._mode)
        except LmsError:                    # intact, but nothing that this scanner should send
            return None
        if scan is None:
            return None
        self._waited, self._bytes = 0.0, self.counts.bytes
        self.status = item.telegram.payload[-1]
        noise = self.counts.noise_bytes + self.counts.crc_errors
        disturbed, self._noise = noise != self._noise, noise
        return self.stamper.date(scan, self.stream, item.begin_ns, disturbed)

    def listen(self, listener: Callable[[bytes, int], object] | None) -> None:
        """Have the bytes and the time of every read passed on to somebody, or to nobody."""
        assert self._device is not None
        self._device.line.listener = listener

    def run(self, publish: Callable[[TimedScan], None]) -> None:
        """Stream until cancelled or a capture's end; get the stream back whenever it breaks."""
        while not self._cancelled():
            try:
                for scan in self.scans(0.1):
                    publish(scan)
            except CaptureEndError as end:
                logger.info('%s', end)
                self.close()
                return
            except LmsError as error:
                logger.warning('%s; reconnecting', error)
                self._reconnect()

    def _reconnect(self) -> None:
        """Try until the scanner streams again, or cancelled."""
        self.streaming = False
        began, said, attempt = time.monotonic(), '', 0
        while not self._cancelled():
            attempt += 1
            usual = (self.settings.serial_baud, POWER_ON_RATE)
            try:
                self.connect(() if attempt % ALL_RATES_EVERY == 0 else usual, rounds=1)
                self.start()
            except CancelledError:
                return
            except LmsError as error:
                if str(error) != said:
                    said = str(error)
                    logger.warning('%s', said)
                self.state = f'reconnecting: {said}'
                time.sleep(min(BACK_OFF[0] * 2**attempt, BACK_OFF[1]))
            else:
                self.reconnects += 1
                logger.info('%s: streaming again after %.1f s', self.settings.serial_port,
                            time.monotonic() - began)
                return

    def stop(self) -> None:
        """Let the scanner fall silent; raises LmsError if it does not answer."""
        self.streaming, self.state = False, 'ready'
        self.stamper.pause()
        if self._device is not None:
            Device(self._device.line).stop()

    def leave(self) -> None:
        """Leave the scanner silent at 9600 Bd, as far as it answers, and close the port."""
        if self._device is not None:
            device = Device(self._device.line)      # one that is not cancelled
            try:
                if not self.streaming:              # at which rate it is, is not sure
                    device.find((self.settings.serial_baud, POWER_ON_RATE), rounds=1)
                device.leave()
            except LmsError as error:
                logger.warning('%s; the scanner may still be streaming', error)
        self.close()

    def close(self) -> None:
        """Close the port, and leave the scanner as it is."""
        self.streaming, self.state = False, 'not connected'
        if self._device is not None:
            self._device.line.close()
            self._device = None


def open_line(name: str, counts: LineCounts | None = None) -> Line:
    """Return the line behind a port, its URL, or a capture; raises LmsError."""
    return Line(open_capture(Path(name)) or open_port(name), name, counts)
