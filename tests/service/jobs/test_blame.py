"""Who is blamed for failures: one device, or the job."""

from __future__ import annotations

from penumbra_service.jobs.blame import MAX_FAILURES, Blame, Verdict


def test_a_device_that_fails_three_times_is_blocked_and_the_job_goes_on():
    blame = Blame()
    verdicts = [blame.failed("a", n, {"a"}) for n in range(1, MAX_FAILURES + 1)]
    assert verdicts == [Verdict.GO_ON, Verdict.GO_ON, Verdict.BLOCK]


def test_three_devices_in_a_row_without_a_result_are_the_jobs_fault():
    blame = Blame()
    assert blame.failed("a", 1, {"a"}) is Verdict.GO_ON
    assert blame.failed("b", 1, {"b"}) is Verdict.GO_ON
    assert blame.failed("c", 1, {"c"}) is Verdict.FAIL


def test_results_in_between_speak_for_the_job():
    blame = Blame()
    for device in "abcdef":
        assert blame.failed(device, 1, {device}) is Verdict.GO_ON
        blame.delivered()


def test_work_that_fails_on_three_devices_is_the_jobs_fault_whatever_else_goes_well():
    blame = Blame()
    for n, device in enumerate("abc", 1):
        blame.delivered()
        verdict = blame.failed(device, 1, set("abc"[:n]))
    assert verdict is Verdict.FAIL
