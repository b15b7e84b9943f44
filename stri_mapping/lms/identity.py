# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a scanner tells of itself when it is found."""

from __future__ import annotations

from dataclasses import dataclass

from stri_mapping.lms.answers import ErrorList
from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.models import identify, Model
from stri_mapping.lms.status import Status


@dataclass(frozen=True)
class Identity:
    """Who a scanner is and how it is set: type, status, configuration, fault memory."""

    type_text: str
    status: Status
    configuration: Configuration
    errors: ErrorList

    @property
    def name(self) -> str:
        """Type, variant, firmware and serial number, in words."""
        text = ' '.join(self.type_text.strip(' \0').split(';'))
        return f'{text}, serial number {self.status.serial_number.strip()}'

    @property
    def product(self) -> str:
        """Type and variant, such as "LMS291-S05"."""
        return '-'.join(self.type_text.strip(' \0').split(';')[:2])

    @property
    def model(self) -> Model:
        """Its type; raises LmsError if it is none of the family."""
        return identify(self.type_text)
