"""A service in a process of its own is killed while it renders on a farm; its next process finishes the job, and the EXR has
the bits of the undisturbed picture in every channel."""

from __future__ import annotations


def test_a_killed_service_goes_on_from_its_snapshot(
    farm, service, make_task, picture, local_run, channels, tmp_path
):  # type: ignore[no-untyped-def]
    farm.wait_for("one", "two")
    task = make_task("steady", stop={"samples": 2048})
    service.start()
    job = service.submit(task.scene.model_dump(mode="json"))
    service.wait(job, lambda status: status["progress"] > 0.2)
    tiles = tmp_path / "data" / "work" / job / "tiles"
    farm.wait_until(lambda: list(tiles.glob("*.tile")), "a snapshot is written")
    service.kill()
    service.start()
    service.wait(job, lambda status: status["state"] == "done")
    receipt = service.get(f"/v1/jobs/{job}/receipt.json").json()
    found = channels(service.get(f"/v1/jobs/{job}/result.exr").content, tmp_path)
    expected = picture(local_run(make_task("plain", "local", stop={"samples": 2048})))
    assert found == expected
    assert receipt["resumed"] == 1
    assert receipt["bit_class"] == "fake|1.0"
