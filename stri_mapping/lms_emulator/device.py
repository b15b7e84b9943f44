# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""One emulated scanner as a state machine in given times: no clock, no port, no thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import heapq
from itertools import count
import math

from stri_mapping.lms import requests
from stri_mapping.lms.answers import PowerOn
from stri_mapping.lms.telegram import ACK, ANSWER, frame, NAK, Telegram
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.intake import Heard, Intake
from stri_mapping.lms_emulator.line import Adapter, Arrival, BITS, Line
from stri_mapping.lms_emulator.mishaps import AWAY, DEAD, Mishaps
from stri_mapping.lms_emulator.model import Memory
from stri_mapping.lms_emulator.replies import Replies, Reply, Timing
from stri_mapping.lms_emulator.streams import make_stream, Stream
from stri_mapping.lms_emulator.turns import Mirror, TurnSource
from stri_mapping.lms_emulator.uart import resampled

FAST_LINE = 500000
FOREVER = math.inf


@dataclass
class Counts:
    """What happened so far."""

    scans: int = 0              # telegrams with measured values that were begun
    dropped: int = 0            # scans that were over while the line was busy
    starved: int = 0            # scans that the source could not tell in time
    interrupted: int = 0        # telegrams cut by a request
    requests: int = 0           # requests that were taken


class EmulatedLms:
    """
    A scanner of the LMS 2xx family between a source of scans and a serial line.

    All times are seconds on one axis of the caller's choice.  The caller passes on what the
    host sends with `receive`, fetches what reaches the host with `arrivals`, and does so at
    the latest at `next_due`; called later, the scanner still does everything at its own times.

    Parameters
    ----------
    source
        Tells what each turn of the mirror measures.
    memory
        Type and settings; what it holds at first is the state in which the host finds the
        scanner, a streaming mode included.
    mirror, timing, adapter
        The mirror's clock, how long answers take, and the host's end of the line.
    faults
        What goes wrong.
    begin
        When it all starts.
    seed
        Draws what faults do.

    Attributes
    ----------
    counts
        What happened so far.

    """

    def __init__(
        self,
        source: TurnSource,
        memory: Memory | None = None,
        *,
        mirror: Mirror = Mirror(),
        timing: Timing = Timing(),
        adapter: Adapter = Adapter(),
        faults: Iterable[Fault] = (),
        begin: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Power the scanner on; it is ready at once."""
        self.memory = Memory() if memory is None else memory
        self.mirror, self.timing, self.counts = mirror, timing, Counts()
        self._source, self._mishaps = source, Mishaps(seed)
        self._line, self._intake = Line(adapter, self._mishaps.late), Intake()
        self._replies = Replies(self.memory, mirror, timing, source)
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = count()
        self._garbled_until = -math.inf     # until when a host at another rate has read
        self._life = 0                      # which start of the scanner this is
        self._ready, self._answering = True, False
        self._stream: Stream | None = None
        self._last_turn = 0                 # of the next scan
        self._after_first_scan: list[Fault] = []
        for fault in faults:
            if fault.since == 'start':
                self.inject(fault, begin)
            else:
                self._after_first_scan.append(fault)
        self._begin_stream(requests.SwitchMode(self.memory.mode), begin)

    @property
    def streaming(self) -> bool:
        """Whether it sends scans without being asked for each."""
        return self._stream is not None

    @property
    def next_due(self) -> float:
        """When `arrivals` should next be called; infinity for not before `receive`."""
        event = self._events[0][0] if self._events else FOREVER
        return min(self._line.next_due, event, self._scan_due)

    def present(self, now: float) -> bool:
        """Tell whether the device of the port is there."""
        return self._mishaps.active(AWAY, now) is None

    def inject(self, fault: Fault, now: float) -> None:
        """Let something go wrong `fault.at` seconds from now."""
        begin, end = self._mishaps.add(fault, now)
        self._at(begin, lambda at: self._fault_begins(fault, at), always=True)
        self._at(end, lambda at: self._fault_ends(fault, at), always=True)

    def arrivals(self, now: float, host_rate: int) -> list[Arrival]:
        """
        Return, once, what reaches the host until now.

        Parameters
        ----------
        now
            Seconds.
        host_rate
            Rate at which the host listens; at any other than the scanner's it gets garbage.

        """
        self._run(now)
        return [arrival if arrival.rate == host_rate else self._garbage(arrival, host_rate)
                for arrival in self._line.arrived(now)
                if self._mishaps.active(DEAD, arrival.due) is None]

    def _garbage(self, arrival: Arrival, host_rate: int) -> Arrival:
        """Return what a host at another rate reads, no more than it has time to."""
        most = int(min(arrival.due - self._garbled_until, 1.0) * host_rate / BITS)
        read = resampled(arrival.data, arrival.rate, host_rate)[:max(most, 0)]
        if read:
            self._garbled_until = arrival.due
        return Arrival(arrival.due, read, host_rate)

    def receive(self, data: bytes, now: float, host_rate: int) -> None:
        """Take bytes that the host has sent at its rate, the first of them now."""
        self._run(now)
        if host_rate != self.memory.rate or not self._hears(now):
            self._intake.clear()
            return
        for heard in self._intake.feed(data, now, host_rate):
            self._at(heard.at, lambda at, heard=heard: self._heard(heard))  # type: ignore[misc]

    def _at(self, due: float, event: Callable[[float], None], always: bool = False) -> None:
        """Let something happen at a time, unless the scanner is restarted before."""
        life = self._life

        def guarded(at: float) -> None:
            if always or life == self._life:
                event(at)

        heapq.heappush(self._events, (due, next(self._order), guarded))

    @property
    def _scan_due(self) -> float:
        if self._stream is None:
            return FOREVER
        return self.mirror.begin(self._last_turn + 1) + self.timing.send_delay

    def _run(self, now: float) -> None:
        """Do all that is due until now, in its order."""
        while True:
            scan_due = self._scan_due
            if self._events and self._events[0][0] <= min(now, scan_due):
                due, _, event = heapq.heappop(self._events)
                event(due)
            elif scan_due <= now:
                self._scan(scan_due)
            else:
                return

    def _scan(self, due: float) -> None:
        """Send the scan that is complete, if the line is free."""
        assert self._stream is not None
        last = self._last_turn
        self._last_turn += self._stream.turns
        if self._answering or self._line.free_at > due + 1e-9:
            self.counts.dropped += 1
            return
        payload = self._stream.payload(last, self.counts.scans)
        if payload is None:
            self.counts.starved += 1
            return
        self.counts.scans += 1
        self._transmit(frame(payload, ANSWER), due)
        for fault in self._after_first_scan:
            self.inject(fault, due)
        self._after_first_scan.clear()

    def _heard(self, heard: Heard) -> None:
        """Take a telegram of the host."""
        at, telegram = heard
        if self._answering or not self._hears(at) or self._mishaps.hits('miss', at):
            return
        if telegram is not None and telegram.address not in (0, self.memory.address):
            return
        if self._line.free_at > at:
            self.counts.interrupted += 1
            self._line.cut(at)
        if telegram is None or self._mishaps.hits('nak', at):
            self._at(at + self.timing.ack, lambda due: self._send_byte(NAK, due))
            return
        self.counts.requests += 1
        self._answer(telegram, at)

    def _answer(self, telegram: Telegram, at: float) -> None:
        reply = self._replies.to(telegram.payload, at)
        if reply.stops:
            self._stream = None
        self._answering = True
        self._at(at + self.timing.ack, lambda due: self._send_byte(ACK, due))
        address = ANSWER + telegram.address
        self._at(max(reply.at, at + self.timing.ack), lambda due: self._send(reply, address, due))

    def _send_byte(self, byte: int, due: float) -> None:
        self._transmit(bytes((byte,)), due)

    def _send(self, reply: Reply, address: int, due: float) -> None:
        """Send an answer; what it says takes effect once it has left."""
        self._answering = False
        payload = reply.payload()
        if payload is None:
            return
        end = self._transmit(frame(payload, address), due)
        if reply.effect is not None:
            effect = reply.effect
            self._at(end, lambda at: self._take_effect(effect, at))

    def _take_effect(self, effect: Callable[[], requests.Request | None], at: float) -> None:
        request = effect()
        if isinstance(request, requests.SwitchMode):
            self._begin_stream(request, at)
        elif isinstance(request, requests.Reset):
            self._restart(at)

    def _begin_stream(self, request: requests.SwitchMode, at: float) -> None:
        """Begin with the first scan that is measured as a whole from now on."""
        self._stream = make_stream(request, self.memory, self._source)
        if self._stream is not None:
            turns = self._stream.turns
            first = -(-self.mirror.next_turn(at) // turns) * turns
            self._last_turn = first + turns - 1

    def _transmit(self, data: bytes, at: float) -> float:
        """Send bytes, or what faults make of them; return when they have left."""
        size = self.memory.model.burst if self.memory.rate == FAST_LINE else len(data)
        data, end = self._mishaps.spoilt(data, at), at
        for turn, k in enumerate(range(0, len(data), size)):
            end = self._line.send(data[k:k + size], at + turn * self.mirror.period,
                                  self.memory.rate)
        return end

    def _restart(self, at: float) -> None:
        """Begin anew as after power-on, and say so when ready."""
        self._life += 1
        self._ready, self._answering, self._stream = False, False, None
        self._line.cut(at)
        self._intake.clear()
        self.memory.restart()
        self._at(at + self.timing.start, self._started)

    def _started(self, at: float) -> None:
        self._ready = True
        self._transmit(frame(PowerOn(self.memory.model.text).encode(), ANSWER + 1), at)

    def _hears(self, at: float) -> bool:
        return self._ready and self._mishaps.active(DEAD, at) is None

    def _fault_begins(self, fault: Fault, at: float) -> None:
        if fault.kind == 'reset':
            self._restart(at)
        elif fault.kind == 'power_cycle':
            self._life += 1
            self._ready, self._answering, self._stream = False, False, None
        elif fault.kind == 'wrong_rate':
            self.memory.rate = fault.rate
        elif fault.kind == 'streaming':
            self.memory.mode = self.memory.model.stream
            self._begin_stream(requests.SwitchMode(self.memory.mode), at)
        if fault.kind in AWAY:
            self._line.clear()
            self._intake.clear()

    def _fault_ends(self, fault: Fault, at: float) -> None:
        if fault.kind == 'power_cycle':
            self._restart(at)
