# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The telegrams with measured values that a scanner can send, by operating mode."""

from __future__ import annotations

from collections.abc import Callable
import struct
from typing import NamedTuple

import numpy as np

from stri_mapping.lms import samples
from stri_mapping.lms.requests import (
    ALL_VALUES,
    AT_ONCE,
    EVERY_TURN,
    PAIRS,
    REMISSION,
    SUB_RANGE,
    SwitchMode,
)
from stri_mapping.lms_emulator.model import Memory
from stri_mapping.lms_emulator.turns import (
    Array,
    remission_units,
    Turn,
    TurnSource,
    WHITE_BYTE,
    WHITE_WORD,
    whole,
    words,
)

MAX_RANGES = 5


class Stream(NamedTuple):
    """
    How an operating mode measures.

    Attributes
    ----------
    turns
        Turns of the mirror that make one telegram.
    payload
        From the number of the last of them, and the telegram index, to the payload; None where
        the source cannot tell the scan.

    """

    turns: int
    payload: Callable[[int, int], bytes | None]


def make_stream(request: SwitchMode, memory: Memory, source: TurnSource) -> Stream | None:
    """Return the stream that a mode switch asks for; None if this scanner has it not."""
    try:
        arguments = struct.unpack(f'<{len(request.parameters) // 2}H', request.parameters)
    except struct.error:
        return None
    make = _MAKERS.get(request.mode)
    return None if make is None else make(memory, source, arguments)


def _all_values(memory: Memory, source: TurnSource, arguments: tuple[int, ...]) -> Stream | None:
    def payload(last: int, telegram: int) -> bytes | None:
        turn = whole(source, memory.variant, last)
        return None if turn is None else samples.Scan(
            _samples(turn.ranges, memory), _indices(memory, last, telegram)).encode()

    return None if arguments else Stream(memory.variant.turns, payload)


def _every_turn(memory: Memory, source: TurnSource, arguments: tuple[int, ...]) -> Stream | None:
    def payload(last: int, telegram: int) -> bytes | None:
        turn = source.turn(last, memory.variant.bearings(last, wide=True))
        return None if turn is None else samples.Scan(
            _samples(turn.ranges, memory, memory.variant.raster(last)),
            _indices(memory, last, telegram)).encode()

    return None if arguments or memory.model.fast else Stream(1, payload)


def _sub_range(memory: Memory, source: TurnSource, arguments: tuple[int, ...]) -> Stream | None:
    if len(arguments) != 2:
        return None
    first, end = arguments[0] & ~AT_ONCE, arguments[1]
    if not _inside(memory, first, end):
        return None
    if arguments[0] & AT_ONCE:
        return _part_of_turns(memory, source, first, end)

    def payload(last: int, telegram: int) -> bytes | None:
        turn = whole(source, memory.variant, last)
        return None if turn is None else samples.SubRange(
            first, end, _samples(turn.ranges[first - 1:end], memory),
            _indices(memory, last, telegram)).encode()

    return Stream(memory.variant.turns, payload)


def _part_of_turns(memory: Memory, source: TurnSource, first: int, end: int) -> Stream:
    """Return the stream of those of the values `first` to `end` that each turn measures."""
    def payload(last: int, telegram: int) -> bytes | None:
        turns = memory.variant.turns
        own = slice(-(-(first - 1 - last % turns) // turns), -(-(end - last % turns) // turns))
        turn = source.turn(last, memory.variant.bearings(last))
        return None if turn is None else samples.SubRange(
            first, end, _samples(turn.ranges[own], memory, memory.variant.raster(last)),
            _indices(memory, last, telegram)).encode()

    return Stream(1, payload)


def _pairs(memory: Memory, source: TurnSource, arguments: tuple[int, ...]) -> Stream | None:
    limits = list(zip(arguments[1::2], arguments[2::2]))
    if not limits or arguments[0] != len(limits) or len(arguments) % 2 == 0:
        return None
    if len(limits) > MAX_RANGES or not all(_inside(memory, *limit) for limit in limits):
        return None

    def payload(last: int, telegram: int) -> bytes | None:
        turn = whole(source, memory.variant, last)
        return None if turn is None else samples.PairScan(
            tuple(_pair_range(turn, memory, *limit) for limit in limits),
            _indices(memory, last, telegram)).encode()

    return Stream(memory.variant.turns, payload)


def _pair_range(turn: Turn, memory: Memory, first: int, last: int) -> samples.PairRange:
    part = slice(first - 1, last)
    pairs = np.empty((last - first + 1, 2), '<u2')
    pairs[:, 0] = words(turn.ranges[part], memory.configuration)
    pairs[:, 1] = remission_units(turn.remission, len(turn.ranges), WHITE_WORD)[part]
    return samples.PairRange(first, last, samples.Samples(
        pairs.tobytes(), memory.configuration.unit))


def _remission(memory: Memory, source: TurnSource, arguments: tuple[int, ...]) -> Stream | None:
    if not memory.model.fast or len(arguments) != 2 or not _inside(memory, *arguments):
        return None
    first, end = arguments

    def payload(last: int, telegram: int) -> bytes | None:
        turn = source.turn(last, memory.variant.bearings(last))
        if turn is None:
            return None
        light = remission_units(turn.remission, len(turn.ranges), WHITE_BYTE).astype(np.uint8)
        part = slice(first - 1, end)
        return samples.RemissionScan(
            _samples(turn.ranges[part], memory), first, end, light[part].tobytes(),
            _indices(memory, last, telegram)).encode()

    return Stream(1, payload)


_MAKERS = {ALL_VALUES: _all_values, EVERY_TURN: _every_turn, SUB_RANGE: _sub_range,
           PAIRS: _pairs, REMISSION: _remission}


def _inside(memory: Memory, first: int, last: int) -> bool:
    variant = memory.variant
    return 1 <= first <= last <= variant.angle * 100 // variant.resolution + 1


def _samples(ranges: Array, memory: Memory, raster: int | None = None) -> samples.Samples:
    return samples.Samples(words(ranges, memory.configuration).tobytes(),
                           memory.configuration.unit, raster)


def _indices(memory: Memory, last: int, telegram: int) -> samples.Indices | None:
    if not memory.configuration.indices:
        return None
    return samples.Indices(last % 256, telegram % 256)
