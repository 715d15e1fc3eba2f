"""What one job may ask for, by the operator's settings: samples of all its pixels and frames, seconds of a picture. Pure."""

from __future__ import annotations

from penumbra_scene.adaptive import Adaptive, in_force
from penumbra_scene.errors import ProblemItem
from penumbra_scene.job import JobRequest

from penumbra_service.film.replicates import choose_layout, pilot_samples
from penumbra_service.settings import Settings


def beyond(request: JobRequest, settings: Settings, base: str) -> list[ProblemItem]:
    """What it asks for beyond that. `base`: the pointer to the scene in what was sent."""
    stop = request.resolved_scene().stop
    at = f"{base if request.stop is None else ''}/stop"
    found = []
    samples, most = samples_of(request), settings.max_job_samples
    if samples is not None and most and samples > most:
        found.append(
            ProblemItem(
                pointer=f"{at}/samples",
                message="this service takes no job of so many samples",
                given=f"{samples} over all pixels and frames",
                accepted=f"at most {most} (PENUMBRA_MAX_JOB_SAMPLES)",
            )
        )
    longest = settings.max_picture_seconds
    if stop.seconds is not None and longest and stop.seconds > longest:
        found.append(
            ProblemItem(
                pointer=f"{at}/seconds",
                message="this service renders no picture for so long",
                given=f"{stop.seconds:g}",
                accepted=f"at most {longest:g} (PENUMBRA_MAX_PICTURE_SECONDS)",
            )
        )
    return found


def samples_of(request: JobRequest) -> int | None:
    """Of all pixels and frames, at most, whole replicates as they are rendered, with what a certified pilot was asked to take
    beside the picture's; None where the stop rule does not tell."""
    scene = request.resolved_scene()
    layout = choose_layout(scene.sampler, scene.stop.model_copy(update={"relative_error": None}))
    if layout.samples is None:
        return None
    window = scene.film.window
    each = layout.samples + _dropped(in_force(scene.adaptive), layout.replicates)
    return each * window.width * window.height * max(len(request.sequence), 1)


def _dropped(adaptive: Adaptive | None, replicates: int) -> int:
    """Samples a pixel that decide and are not kept, where their number was asked for."""
    if adaptive is None or adaptive.biased or adaptive.pilot_samples is None:
        return 0
    return replicates * pilot_samples(-(-adaptive.pilot_samples // replicates))


def within(request: JobRequest, settings: Settings) -> JobRequest:
    """The job with an end to each of its pictures: one that stops at an error ends with the time that a picture may take.
    Where samples alone decide, nothing is added: they are planned for that number, and have a limit of their own."""
    stop, longest = request.resolved_scene().stop, settings.max_picture_seconds
    if not longest or stop.relative_error is None or stop.seconds is not None:
        return request
    return request.model_copy(update={"stop": stop.model_copy(update={"seconds": longest})})
