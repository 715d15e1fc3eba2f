"""A quote: what accuracy will cost in time, told before the work from a pilot of about two seconds."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from penumbra_scene.base import Float, Integer, Measured, Model, NotBoolean, Unit
from penumbra_scene.job import Count, ErrorPoint, Interval, StopReason
from penumbra_scene.receipt import ReceiptDevice, StageTime
from penumbra_scene.settings import Stop


class QuotedError(Model):
    """What one relative error takes: totals from a render's start, compiling not counted."""

    relative_error: Measured
    """sqrt(relmse) that the render would stop at, with the stop rule's confidence."""
    samples: Measured
    """A pixel."""
    samples_interval: Interval
    seconds: Measured
    """Of tracing, on all devices of the quote."""
    seconds_interval: Interval


class QuotedEnd(Model):
    """What the scene's own stop rule comes to."""

    reason: StopReason
    """The rule that is expected to hold first."""
    samples: Measured
    samples_interval: Interval
    seconds: Measured
    seconds_interval: Interval
    relative_error: Measured | None = None
    """Null: the sampler gives no variance."""
    relative_error_interval: Interval | None = None


class Pilot(Model):
    """What was rendered to find out."""

    pixels: Count
    blocks: Count
    """Blocks of 16 x 16 pixels that were rendered, spread evenly over the picture."""
    blocks_in_picture: Count
    samples: Measured
    """A pixel, of the last round."""
    seconds: Measured
    """By the clock, from the moment when the scene was loaded."""
    curve: tuple[ErrorPoint, ...] = ()
    """The error as it fell; its seconds are those that the whole picture would have taken."""


class Quote(Model):
    """Error against time for one scene on the devices at hand."""

    schema_version: Annotated[Literal[1], NotBoolean] = 1
    name: str
    scene_hash: str
    picture_hash: str
    stop: Stop
    """The rule that `end` is about."""
    sampler: str
    replicates: Integer
    table: tuple[QuotedError, ...] = ()
    """From coarse to fine; empty where the sampler gives no variance."""
    end: QuotedEnd
    theta: Float | None = None
    """Fitted exponent: variance falls as samples^-theta."""
    theta_interval: tuple[Float, Float] | None = None
    seconds_per_sample: Measured
    """Of one sample in every pixel of the picture, on all devices together."""
    compile: StageTime
    """Building the program: it comes on top where it is cold. A job that follows finds it warm."""
    build: StageTime
    """Decoding assets, making trees, uploading: on top as well."""
    pilot: Pilot
    flagged_share: Unit = 0.0
    """Of the pilot's pixels: rare bright samples, or too few with light. The larger, the less the quote is worth."""
    replicates_advised: Integer | None = None
    """8 where splitting into so many costs at most 1.3 times the samples, by the pilot's exponent, else 4."""
    splitting_price: Measured | None = None
    """Samples to a given error with these replicates over those of one undivided sequence."""
    devices: tuple[ReceiptDevice, ...] = ()
    warnings: tuple[str, ...] = ()


QUOTED_ERRORS: Final = (0.1, 0.05, 0.02, 0.01, 0.005)
"""Relative errors of the table; the scene's own target joins them."""
