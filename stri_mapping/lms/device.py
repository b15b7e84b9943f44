# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""One scanner on a line: found, asked, set up, started, and left as a next user expects it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import time
from typing import TypeVar

from stri_mapping.errors import LmsError
from stri_mapping.lms.answers import (
    Answer,
    ConfigurationRead,
    ConfigurationWritten,
    decode_answer,
    ErrorList,
    ModeAnswer,
    Refused,
    TypeAnswer,
    VariantAnswer,
)
from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.identity import Identity
from stri_mapping.lms.line import Line
from stri_mapping.lms.models import Variant
from stri_mapping.lms.parser import Handshake, Received
from stri_mapping.lms.requests import (
    INSTALLATION,
    ON_REQUEST,
    PASSWORD,
    RATES,
    ReadConfiguration,
    ReadErrors,
    ReadStatus,
    ReadType,
    Request,
    SetVariant,
    SwitchMode,
    WriteConfiguration,
)
from stri_mapping.lms.status import Status
from stri_mapping.lms.stream import Stream
from stri_mapping.lms.telegram import NAK

Wanted = TypeVar('Wanted', bound=Answer)
# Line rate of a scanner that was just powered.
POWER_ON_RATE = 9600
# Seconds: until the ACK (60 ms, but USB adapters hold it back), of an answer, of a mode switch
# (TL 4.3), of a configuration's write (up to 7 s by an old manual), after a NAK (30 ms or more).
ACK_TIME, ANSWER_TIME, SWITCH_TIME, WRITE_TIME, NAK_PAUSE = 0.25, 1.0, 3.0, 15.0, 0.1
# At some mirror positions a scanner misses a request altogether (TL 4.3).
TRIES = 3
# The same of the last requests: a computer that lags misses three answers, and a scanner that has
# not heard them goes on streaming at a rate that others do not look for.
LEAVE_TRIES = 10
# Seconds of silence after which an answer is looked for inside a telegram that it has cut.
SLICE = 0.02
# Between a rate's change and the next request; further requests wait for as long as it takes.
RATE_PAUSE = 0.05


class NoAnswerError(LmsError):
    """Nothing of what a scanner would say came back."""


class CancelledError(LmsError):
    """The wait was given up because the user wants the end."""


class Device:
    """
    One scanner.

    Parameters
    ----------
    line
        Where it is.
    cancelled
        Asked during all waiting; once it returns True, CancelledError is raised.

    Attributes
    ----------
    retries
        Requests that had to be sent again.

    """

    def __init__(self, line: Line, cancelled: Callable[[], bool] = lambda: False) -> None:
        """Send nothing yet."""
        self.line = line
        self.retries = 0
        self._cancelled = cancelled

    def ask(
        self,
        request: Request,
        wanted: type[Wanted],
        patience: float = ANSWER_TIME,
        tries: int = TRIES,
    ) -> Wanted:
        """
        Send a request and return its answer.

        Parameters
        ----------
        request
            What to ask.
        wanted
            Class of the answer; anything else that comes is passed over.
        patience
            Seconds to wait for the answer after the ACK.
        tries
            How often to send it.

        Raises
        ------
        NoAnswerError
            If no answer came.
        LmsError
            If the scanner refuses, or the port is gone.

        """
        for attempt in range(tries):
            self.retries += attempt > 0
            self.line.flush()
            self.line.send(request.encode())
            answer = self._await(wanted, patience)
            if answer is not None:
                return answer
        raise NoAnswerError(f'{self.line.name}: no answer to {request} at {self.line.rate} Bd')

    def _await(self, wanted: type[Wanted], patience: float) -> Wanted | None:
        """Return the next answer of a class; None if it does not come, or the request did not."""
        sent = time.monotonic() + self._transfer(100)
        end = sent + ACK_TIME
        while (left := end - time.monotonic()) > 0.0:
            for item in self._receive(min(left, SLICE)):
                if not isinstance(item, Received):
                    if item.code == NAK:
                        time.sleep(NAK_PAUSE)
                        return None
                    end = sent + patience
                    continue
                answer = _decoded(item)
                if isinstance(answer, Refused):
                    raise LmsError(f'{self.line.name}: the scanner refuses: wrong mode or '
                                   'parameter')
                if isinstance(answer, wanted):
                    return answer
        return None

    def _transfer(self, size: int) -> float:
        """Return the seconds that so many bytes take."""
        return 10.0 * size / self.line.rate if self.line.rate else 0.0

    def _receive(self, timeout: float) -> list[Received | Handshake]:
        if self._cancelled():
            raise CancelledError('interrupted')
        return self.line.receive(timeout)

    def find(self, rates: Sequence[int], rounds: int = TRIES) -> Status:
        """
        Find the line rate of the scanner, stop its stream, and return its status.

        Parameters
        ----------
        rates
            To be tried, in this order; a port without a rate of its own has but one.
        rounds
            How often to try all of them.

        Raises
        ------
        NoAnswerError
            If it answers at none of them.

        """
        for rate in rounds * tuple(rates if self.line.adjustable else rates[:1]):
            self.line.rate = rate
            try:
                if not self._stopped():
                    continue
                status = self.ask(ReadStatus(), Status)
            except NoAnswerError:
                continue                # that was noise, or a late answer at an earlier rate
            if not self.line.adjustable and status.rate:
                self.line.rate = status.rate
            return status
        tried = ', '.join(map(str, dict.fromkeys(rates)))
        raise NoAnswerError(
            f'{self.line.name}: no LMS 2xx answers at {tried} Bd: is it '
            'powered (it needs up to 60 s to start), the cable for RS-232 or RS-422 as its plug '
            'is bridged, and this the right port?')

    def _stopped(self) -> bool:
        """Return whether a scanner at the present rate has stopped; False where none is heard."""
        self.line.flush()
        noise = self.line.counts.noise_bytes
        self.line.send(SwitchMode(ON_REQUEST).encode())
        heard = False
        end = time.monotonic() + ACK_TIME + self._transfer(25)
        while (left := end - time.monotonic()) > 0.0:
            for item in self._receive(min(left, SLICE)):
                if isinstance(item, Received) and isinstance(_decoded(item), ModeAnswer):
                    return True
                # at a wrong rate, an ACK is easily found in what a stream looks like
                if isinstance(item, Received) or self.line.counts.noise_bytes == noise:
                    heard = True
        if heard:
            self.stop()
        return heard

    def switch(self, request: SwitchMode, tries: int = TRIES) -> None:
        """Change the operating mode; raises LmsError if the scanner refuses it."""
        if self.ask(request, ModeAnswer, SWITCH_TIME, tries).result != 0:
            raise LmsError(f'{self.line.name}: the scanner refuses mode 0x{request.mode:02X}')

    def set_rate(self, rate: int) -> Status | None:
        """
        Change the line rate of scanner and port to a key of `RATES`.

        Returns
        -------
        Status or None
            The scanner's status at the new rate; None if there was nothing to change.

        Raises
        ------
        LmsError
            If port or scanner cannot do it.

        """
        if rate == self.line.rate or not self.line.adjustable:
            return None
        present = self.line.rate
        self.switch(SwitchMode(RATES[rate]))
        self.line.rate = rate
        time.sleep(RATE_PAUSE)
        try:
            return self.ask(ReadStatus(), Status)
        except NoAnswerError:
            self.line.send(SwitchMode(RATES[present]).encode())     # it may hear, if not be heard
            time.sleep(ACK_TIME)
            self.line.rate = present
            raise NoAnswerError(f'{self.line.name}: the scanner does not answer at {rate} Bd: '
                                'over 38400 Bd needs RS-422, at both ends') from None

    def identity(self, status: Status) -> Identity:
        """Ask for the rest of what `Identity` has; the scanner must not stream."""
        return Identity(self.ask(ReadType(), TypeAnswer).text, status,
                        self.ask(ReadConfiguration(), ConfigurationRead).configuration,
                        self.ask(ReadErrors(), ErrorList))

    def configure(self, wanted: Configuration) -> Configuration:
        """
        Write a configuration, which wears the scanner's memory; return what is then active.

        Raises
        ------
        LmsError
            If the scanner does not take it.

        """
        self.switch(SwitchMode(INSTALLATION, PASSWORD))
        try:
            self.ask(WriteConfiguration(wanted.block), ConfigurationWritten, WRITE_TIME,
                     tries=2)
        finally:
            self.switch(SwitchMode(ON_REQUEST))
        active = self.ask(ReadConfiguration(), ConfigurationRead).configuration
        if active != wanted:
            raise LmsError(f'{self.line.name}: the scanner did not take the configuration: it '
                           f'has {active.block.hex(" ")}, wanted {wanted.block.hex(" ")}')
        return active

    def set_variant(self, variant: Variant, status: Status) -> bool:
        """Set angle and resolution; return whether the status did not show them already."""
        if variant.fast or (status.angle, status.resolution) == (variant.angle,
                                                                 variant.resolution):
            return False
        answer = self.ask(SetVariant(variant.angle, variant.resolution), VariantAnswer)
        if not answer.accepted:
            raise LmsError(f'{self.line.name}: the scanner refuses {variant}, and stays at '
                           f'{Variant(answer.angle, answer.resolution)}')
        return True

    def start(self, stream: Stream) -> None:
        """Let it stream."""
        self.switch(stream.request)

    def stop(self, tries: int = TRIES) -> None:
        """Let it fall silent; it then waits for requests."""
        self.switch(SwitchMode(ON_REQUEST), tries)

    def leave(self) -> None:
        """Leave it as after power-on: silent, at 9600 Bd."""
        self.stop(LEAVE_TRIES)
        if self.line.adjustable and self.line.rate != POWER_ON_RATE:
            self.switch(SwitchMode(RATES[POWER_ON_RATE]), LEAVE_TRIES)
            self.line.rate = POWER_ON_RATE


def _decoded(item: Received) -> Answer | None:
    try:
        return decode_answer(item.telegram.payload)
    except LmsError:                    # intact, but none of this family's answers
        return None
