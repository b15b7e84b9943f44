# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a scanner answers to each request, when, and what the request changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from stri_mapping.errors import LmsError
from stri_mapping.lms import answers, requests
from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.measuring import MODES, UNITS
from stri_mapping.lms.requests import Request, SwitchMode
from stri_mapping.lms_emulator.model import Memory
from stri_mapping.lms_emulator.streams import make_stream
from stri_mapping.lms_emulator.turns import Mirror, TurnSource, Variant

# Sub-command of 0x20 that tests the password while monitoring goes on.
TEST_PASSWORD = 0x30
# Modes without output.
IDLE = (requests.INSTALLATION, requests.DIAGNOSIS, requests.ON_REQUEST)
RATE_OF = {sub: rate for rate, sub in requests.RATES.items()}


@dataclass(frozen=True)
class Timing:
    """
    How long things take, seconds; the defaults are what a logged LMS200 took, or TL's limits.

    Attributes
    ----------
    ack
        From the end of a request to ACK or NAK.
    answer
        From the end of a request to the beginning of its answer.
    write
        The same for writing the configuration.
    reset
        From the ACK of a reset to its answer.
    start
        From power-on or reset to the message that the scanner is ready.
    send_delay
        From the end of a scan's last turn to the first byte of its telegram.

    """

    ack: float = 0.005
    answer: float = 0.06
    write: float = 0.25
    reset: float = 0.01
    start: float = 10.0
    send_delay: float = 0.0


class Reply(NamedTuple):
    """
    Answer to a request.

    Attributes
    ----------
    at
        When it begins to leave.
    payload
        Makes its payload at that time; None for no answer.
    effect
        Changes the memory once the answer has left, and returns what is to be begun then.
    stops
        Whether output stops at once.

    """

    at: float
    payload: Callable[[], bytes | None]
    effect: Callable[[], Request | None] | None = None
    stops: bool = False


class Replies:
    """Answers requests by what the memory holds."""

    def __init__(self, memory: Memory, mirror: Mirror, timing: Timing,
                 source: TurnSource) -> None:
        """Take what answers depend on."""
        self._memory, self._mirror, self._timing = memory, mirror, timing
        self._source = source
        self._handlers: dict[type[Request], Callable[[Any, float], Reply]] = {
            requests.Reset: self._reset,
            requests.SwitchMode: self._switch,
            requests.ReadStatus: self._tell(lambda: memory.status(mirror)),
            requests.ReadErrors: self._tell(answers.ErrorList),
            requests.ReadHours: self._tell(lambda: answers.Hours(100, 10)),
            requests.ReadType: self._tell(lambda: answers.TypeAnswer(memory.model.text)),
            requests.ReadConfiguration: self._tell(
                lambda: answers.ConfigurationRead(memory.configuration)),
            requests.WriteConfiguration: self._configure,
            requests.SetVariant: self._set_variant,
            requests.SetPowerOn: self._set_power_on,
            requests.ReadScan: self._read_scan,
            requests.ReadSubRange: partial(self._read_part, requests.SUB_RANGE),
            requests.ReadRemission: partial(self._read_part, requests.REMISSION),
        }

    def to(self, payload: bytes, at: float) -> Reply:
        """Return the reply to a request whose last byte came at a time."""
        try:
            request = requests.decode_request(payload)
        except LmsError:
            return self._refused(at)
        handler = self._handlers.get(type(request))
        return self._refused(at) if handler is None else handler(request, at)

    def _tell(self, answer: Callable[[], answers.Answer]) -> Callable[[Request, float], Reply]:
        """Return a handler that does nothing but give an answer."""
        return lambda request, at: Reply(at + self._timing.answer, lambda: answer().encode())

    def _refused(self, at: float) -> Reply:
        return Reply(at + self._timing.answer, answers.Refused().encode)

    def _reset(self, request: requests.Reset, at: float) -> Reply:
        due = at + self._timing.ack + self._timing.reset
        return Reply(due, answers.ResetTaken().encode, lambda: request, stops=True)

    def _switch(self, request: SwitchMode, at: float) -> Reply:
        due, done = at + self._timing.answer, answers.ModeAnswer().encode
        if request.mode in RATE_OF and not request.parameters:
            return Reply(due, done, partial(self._set_rate, RATE_OF[request.mode]))
        if request.mode in (requests.INSTALLATION, TEST_PASSWORD):
            return self._unlock(request, due)
        idle = request.mode in (requests.ON_REQUEST, requests.DIAGNOSIS)
        if not (idle and not request.parameters
                or make_stream(request, self._memory, self._source) is not None):
            return self._refused(at)
        return Reply(due, done, partial(self._enter, request), stops=True)

    def _unlock(self, request: SwitchMode, due: float) -> Reply:
        """Go into installation mode, or test the password only."""
        right = request.parameters == self._memory.password
        answer = answers.ModeAnswer(0 if right else 1).encode
        if not right or request.mode == TEST_PASSWORD:
            return Reply(due, answer)
        return Reply(due, answer, partial(self._enter, request), stops=True)

    def _enter(self, request: SwitchMode) -> Request:
        self._memory.mode = request.mode
        return request

    def _set_rate(self, rate: int) -> None:
        self._memory.rate = rate

    def _configure(self, request: requests.WriteConfiguration, at: float) -> Reply:
        """Write the configuration; surplus bytes are ignored, missing ones keep what is there."""
        memory = self._memory
        if memory.mode != requests.INSTALLATION:
            return self._refused(at)
        block = request.block[:len(memory.configuration.block)]
        block += memory.configuration.block[len(block):]
        wanted = Configuration(block)
        fits = wanted.unit in UNITS and wanted.measuring_mode in MODES
        if fits:
            memory.configuration = wanted
            memory.writes += 1
        answer = answers.ConfigurationWritten(int(fits), memory.configuration)
        return Reply(at + self._timing.write, answer.encode)

    def _set_variant(self, request: requests.SetVariant, at: float) -> Reply:
        """Set angle and resolution, which stops the output; not to be had on an S14."""
        memory, wanted = self._memory, Variant(request.angle, request.resolution)
        if memory.model.fast:
            return self._refused(at)
        fits = wanted in memory.model.variants
        if fits:
            memory.variant = wanted
        if memory.mode not in IDLE:
            memory.mode = requests.ON_REQUEST
        answer = answers.VariantAnswer(int(fits), *memory.variant)
        return Reply(at + self._timing.answer, answer.encode, stops=True)

    def _set_power_on(self, request: requests.SetPowerOn, at: float) -> Reply:
        fits = request.setting in (0, 1, 2)
        if fits:
            self._memory.keep = request.setting
        answer = answers.PowerOnSet(int(fits), self._memory.keep)
        return Reply(at + self._timing.answer, answer.encode)

    def _read_scan(self, request: requests.ReadScan, at: float) -> Reply:
        if request.kind != 1:
            return self._refused(at)
        return self._read(SwitchMode(requests.ALL_VALUES), at)

    def _read_part(self, mode: int, request: requests.ReadSubRange | requests.ReadRemission,
                   at: float) -> Reply:
        return self._read(SwitchMode(mode, requests.words(request.first, request.last)), at)

    def _read(self, request: SwitchMode, at: float) -> Reply:
        """Answer with the next scan that is complete."""
        stream = make_stream(request, self._memory, self._source)
        if stream is None or self._memory.mode != requests.ON_REQUEST:
            return self._refused(at)
        end = self._mirror.next_turn(at + self._timing.ack)
        end = -(-end // stream.turns) * stream.turns
        return Reply(self._mirror.begin(end) + self._timing.send_delay,
                     partial(stream.payload, end - 1, 0))
