"""The pages as a person with a browser meets them. Script errors and refused content fail every test too."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

pytest.importorskip("playwright", reason="needs the package playwright")
from playwright.sync_api import expect

Scene = dict[str, Any]
WIDE, NARROW = {"width": 1200, "height": 900}, {"width": 360, "height": 740}


def submit(served: Any, scene: Scene, **changes: Any) -> str:
    answer = httpx.post(f"{served.url}/v1/jobs", json={**scene, **changes})
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def streams(served: Any) -> int:
    """Streams of events that are open at the service."""
    return len(served.service.watchers._watches)


def until(page: Any, holds: Any, what: str) -> None:
    for _ in range(200):
        if holds():
            return
        page.wait_for_timeout(50)
    pytest.fail(f"never: {what}")


def test_an_empty_service_says_how_to_submit(served: Any, page: Any) -> None:
    page.goto(served.url)
    expect(page.get_by_role("heading", name="Jobs")).to_be_visible()
    expect(page.get_by_text("There are no jobs")).to_be_visible()
    expect(page.locator("pre")).to_contain_text(f"{served.url}/v1/jobs")


def test_a_job_that_someone_else_submits_appears_by_itself(served: Any, page: Any, scene: Scene) -> None:
    page.goto(f"{served.url}/jobs")
    until(page, lambda: streams(served) == 1, "a stream of events is open")
    submit(served, scene)
    expect(page.locator(".card")).to_have_count(1)
    expect(page.locator(".card strong")).to_have_text("two balls")


def test_the_job_that_is_worked_on_is_first_however_many_wait(served: Any, page: Any, scene: Scene) -> None:
    first = submit(served, scene, name="at work")
    until(page, lambda: state_of(served, first) == "rendering", "the first job is worked on")
    others = [submit(served, scene, name=f"in the queue {i}") for i in range(26)]
    page.goto(f"{served.url}/jobs")
    expect(page.locator(".card")).to_have_count(25)
    expect(page.locator(".card").first).to_have_attribute("id", f"job-{first}")
    expect(page.locator(".card").nth(1)).to_have_attribute("id", f"job-{others[-1]}")
    page.get_by_role("link", name="Older jobs").click()
    expect(page.locator(".card")).to_have_count(2)
    expect(page.locator(".card").last).to_have_attribute("id", f"job-{others[0]}")


def test_a_job_moves_to_the_front_as_it_starts(served: Any, page: Any, scene: Scene) -> None:
    first = submit(served, scene)
    second = submit(served, scene)
    third = submit(served, scene)
    page.goto(f"{served.url}/jobs")
    expect(page.locator(".card").first).to_have_attribute("id", f"job-{first}")
    until(page, lambda: streams(served) == 1, "a stream of events is open")
    served.runner.let()
    expect(page.locator(".card").first).to_have_attribute("id", f"job-{second}")
    expect(page.locator(".card").nth(1)).to_have_attribute("id", f"job-{third}")


def state_of(served: Any, job: str) -> str:
    return str(httpx.get(f"{served.url}/v1/jobs/{job}").json()["state"])


@pytest.mark.parametrize("state", ["queued", "rendering"])
def test_states_have_the_names_that_the_api_gives_them(
    served: Any, page: Any, scene: Scene, state: str
) -> None:
    jobs = [submit(served, scene), submit(served, scene)]
    until(page, lambda: state_of(served, jobs[0]) == "rendering", "the first job is worked on")
    page.goto(f"{served.url}/jobs")
    page.get_by_role("link", name=f"{state} 1").click()
    expect(page).to_have_url(f"{served.url}/jobs?state={state}")
    expect(page.locator(".card .state")).to_have_text(state)


def test_a_card_shows_picture_state_and_progress_as_they_change(served: Any, page: Any, scene: Scene) -> None:
    job = submit(served, scene)
    page.goto(f"{served.url}/jobs")
    card = page.locator(f"#job-{job}")
    expect(card.locator(".state")).to_have_text("rendering")
    expect(card.get_by_text("no picture yet")).to_be_visible()
    served.runner.let(3)
    expect(card.locator("img")).to_have_attribute("src", f"/v1/jobs/{job}/thumbnail.png?r=3")
    assert card.locator("img").evaluate("img => img.naturalWidth") == 160
    expect(card.locator("progress")).to_have_attribute("value", "50")
    served.runner.let(3)
    expect(card.locator(".state")).to_have_text("done")
    expect(card.locator("progress")).to_have_count(0)


def test_the_picture_of_a_job_gets_better_while_one_looks(served: Any, page: Any, scene: Scene) -> None:
    job = submit(served, scene)
    page.goto(f"{served.url}/jobs/{job}")
    for step in (1, 2, 3):
        served.runner.let(1)
        for kind in ("thumbnail", "heatmap"):
            picture = page.locator(f"[data-kind={kind}] img")
            expect(picture).to_have_attribute("src", f"/v1/jobs/{job}/{kind}.png?r={step}")
            assert picture.evaluate("img => img.complete && img.naturalWidth") == 160
    expect(page.locator(".facts")).to_contain_text("5.7 %")
    expect(page.locator(".facts sup")).to_have_text("\u22121.00")
    expect(page.locator('nav a[aria-current="true"]')).to_have_text("Jobs")
    expect(page.locator("svg.plot")).to_have_count(2)
    expect(page.locator("svg.plot circle")).to_have_count(6)
    expect(page.locator("svg.plot .forecast")).to_have_count(2)
    served.runner.let(3)
    expect(page.get_by_role("heading", name="Receipt")).to_be_visible()
    expect(page.get_by_text("its error was low enough")).to_be_visible()
    expect(page.get_by_role("button", name="Cancel")).to_have_count(0)


def test_a_finished_job_offers_its_files_and_each_arrives(served: Any, page: Any, scene: Scene) -> None:
    job = submit(served, scene)
    served.runner.let()
    page.goto(f"{served.url}/jobs/{job}")
    expect(page.get_by_role("heading", name="Receipt")).to_be_visible()
    links = page.locator(".downloads a")
    assert links.all_inner_texts() == ["EXR", "PNG", "Noise map", "Receipt", "Scene"]
    for link in links.all():
        assert httpx.get(served.url + str(link.get_attribute("href"))).status_code == 200
    for words in ("spread of 8 replicates", "the aperture is closed", "shapes/0 emits", "12 (", "warm"):
        expect(page.locator(".receipt")).to_contain_text(words)


def test_a_failed_job_says_why(served: Any, page: Any, scene: Scene) -> None:
    served.runner.fail = True
    job = submit(served, scene)
    page.goto(f"{served.url}/jobs/{job}")
    served.runner.let()
    expect(page.locator(".problem")).to_contain_text("The kernel does not build")
    expect(page.locator(".problem")).to_contain_text("line 7: no such word")


def test_cancel_pause_and_resume_by_their_buttons(served: Any, page: Any, scene: Scene) -> None:
    job = submit(served, scene)
    page.goto(f"{served.url}/jobs/{job}")
    expect(page.locator(".state")).to_have_text("rendering")
    page.get_by_role("button", name="Pause").click()
    expect(page.locator(".state")).to_have_text("paused")
    page.get_by_role("button", name="Resume").click()
    expect(page.locator(".state")).to_have_text("rendering")
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator(".state")).to_have_text("cancelled")
    expect(page.get_by_role("button")).to_have_count(0)


def test_a_job_cancelled_elsewhere_loses_its_buttons_here(served: Any, page: Any, scene: Scene) -> None:
    job = submit(served, scene)
    page.goto(f"{served.url}/jobs/{job}")
    expect(page.get_by_role("button", name="Cancel")).to_be_visible()
    until(page, lambda: streams(served) == 1, "a stream of events is open")
    httpx.post(f"{served.url}/v1/jobs/{job}/cancel")
    expect(page.locator(".state")).to_have_text("cancelled")
    expect(page.get_by_role("button", name="Cancel")).to_have_count(0)


def test_a_tab_has_one_stream_and_none_while_it_is_hidden(served: Any, page: Any, scene: Scene) -> None:
    submit(served, scene)
    submit(served, scene)
    page.goto(f"{served.url}/jobs")
    until(page, lambda: streams(served) == 1, "one stream for all jobs")
    hide = """hidden => {
        Object.defineProperty(document, 'hidden', {value: hidden, configurable: true});
        document.dispatchEvent(new Event('visibilitychange'));
    }"""
    page.evaluate(hide, True)
    until(page, lambda: streams(served) == 0, "no stream while hidden")
    submit(served, scene, name="made while hidden")
    expect(page.locator(".card")).to_have_count(2)
    page.evaluate(hide, False)
    until(page, lambda: streams(served) == 1, "a stream again")
    expect(page.locator(".card")).to_have_count(3)
    page.goto("about:blank")
    until(page, lambda: streams(served) == 0, "no stream once the page is left")


def test_a_wrong_scene_is_shown_with_its_errors_at_their_lines(served: Any, page: Any, scene: Scene) -> None:
    wrong = {**scene, "shapes": [{"type": "quad"}, {"type": "sphere", "radius": -1, "material": "gold"}]}
    page.goto(f"{served.url}/submit")
    text = json.dumps(wrong, indent=2)
    page.get_by_label("Scene", exact=True).fill(text)
    page.get_by_role("button", name="Render").click()
    expect(page.locator(".problem")).to_contain_text("/shapes/1/radius")
    expect(page.locator(".problem")).to_contain_text("given -1")
    expect(page.locator(".problem")).to_contain_text("accepted: a number above 0")
    area = page.get_by_label("Scene", exact=True)
    expect(area).to_have_value(text)
    page.locator(".problem a").first.click()
    chosen = area.evaluate("area => area.value.slice(area.selectionStart, area.selectionEnd)")
    assert chosen.strip() == '"radius": -1,'
    assert httpx.get(f"{served.url}/v1/jobs").json()["items"] == []


def test_a_scene_is_checked_then_rendered_from_the_form(served: Any, page: Any, scene: Scene) -> None:
    page.goto(f"{served.url}/submit")
    page.get_by_label("Scene", exact=True).fill(json.dumps(scene))
    page.get_by_role("button", name="Check only").click()
    expect(page.get_by_role("heading", name="The scene is valid")).to_be_visible()
    assert httpx.get(f"{served.url}/v1/jobs").json()["items"] == []
    page.get_by_role("button", name="Render").click()
    expect(page.get_by_role("heading", name="two balls")).to_be_visible()
    assert len(httpx.get(f"{served.url}/v1/jobs").json()["items"]) == 1


def test_a_quote_shows_what_errors_cost_and_keeps_the_scene(served: Any, page: Any, scene: Scene) -> None:
    page.goto(f"{served.url}/submit")
    page.get_by_label("Scene", exact=True).fill(json.dumps(scene))
    page.get_by_role("button", name="Quote").click()
    expect(page.get_by_role("heading", name="What two balls would cost")).to_be_visible()
    row = page.locator(".quote tr.asked")
    expect(row).to_contain_text("5.0 %")
    expect(row).to_contain_text("1.2 s to 2.6 s")
    assert httpx.get(f"{served.url}/v1/jobs").json()["items"] == []
    page.get_by_role("button", name="Render").click()
    expect(page.get_by_role("heading", name="two balls")).to_be_visible()


def test_a_quote_that_fails_says_why(served: Any, page: Any, scene: Scene) -> None:
    served.runner.fail = True
    page.goto(f"{served.url}/submit")
    page.get_by_label("Scene", exact=True).fill(json.dumps(scene))
    page.get_by_role("button", name="Quote").click()
    expect(page.locator(".problem")).to_contain_text("There is no device to render on")


def test_a_file_of_two_megabytes_can_be_submitted(
    served: Any, page: Any, scene: Scene, tmp_path: Any
) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(scene) + " " * 2_000_000)
    page.goto(f"{served.url}/submit")
    page.get_by_label("or a file").set_input_files(tmp_path / "scene.json")
    page.get_by_role("button", name="Render").click()
    expect(page.get_by_role("heading", name="two balls")).to_be_visible()


def test_assets_are_uploaded_and_their_hashes_put_in_place(
    served: Any, page: Any, scene: Scene, tmp_path: Any
) -> None:
    (tmp_path / "tent.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    named = {**scene, "shapes": [{"type": "mesh", "source": {"file": "assets/tent.obj"}}]}
    page.goto(f"{served.url}/submit")
    page.get_by_label("Scene", exact=True).fill(json.dumps(named))
    page.locator("#assets").set_input_files(tmp_path / "tent.obj")
    # meshes are read in a process of its own, which takes its time on a busy machine
    expect(page.locator("#assets-said")).to_contain_text("1 triangle", timeout=60_000)
    page.get_by_role("button", name="Check only").click()
    expect(page.get_by_role("heading", name="The scene is valid")).to_be_visible()


def test_pages_can_be_read_without_scripts(browser: Any, served: Any, scene: Scene) -> None:
    job = submit(served, scene)
    served.runner.let()
    until_done(served, job)
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(f"{served.url}/jobs")
    expect(page.locator(".card .state")).to_have_text("done")
    page.locator(".card a").click()
    expect(page.get_by_role("heading", name="Receipt")).to_be_visible()
    expect(page.locator("svg.plot")).to_have_count(2)
    page.goto(f"{served.url}/submit")
    page.get_by_label("Scene", exact=True).fill('{"version": 1}')
    page.get_by_role("button", name="Check only").click()
    expect(page.locator(".problem")).to_contain_text("/camera")
    context.close()


def until_done(served: Any, job: str) -> None:
    with httpx.stream("GET", f"{served.url}/v1/jobs/{job}/events", timeout=20) as events:
        for _ in events.iter_lines():
            pass


def test_a_name_cannot_smuggle_markup_in(served: Any, page: Any, scene: Scene) -> None:
    name = "<script>document.title='owned'</script><b>&amp;"
    job = submit(served, scene, name=name)
    for path in ("/jobs", f"/jobs/{job}"):
        page.goto(served.url + path)
        expect(page.locator("body")).to_contain_text(name)
        assert page.title() != "owned"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_nothing_sticks_out_and_text_has_contrast(
    browser: Any, served: Any, scene: Scene, scheme: Any, size: Any
) -> None:
    job = submit(served, scene, name="a name that is rather long and goes on for quite a while " * 2)
    served.runner.let()
    until_done(served, job)
    context = browser.new_context(color_scheme=scheme, viewport=size)
    page = context.new_page()
    for path in ("/jobs", f"/jobs/{job}", "/submit", "/devices", "/docs", "/login"):
        page.goto(served.url + path)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), path
        for selector in ("h1", "nav a", ".button", ".facts dd", ".facts dt", ".state", "button.primary"):
            for ratio in page.evaluate(CONTRAST, selector):
                assert ratio >= 4.5, (path, selector)
    context.close()


# WCAG 2's contrast ratio of every element's text against the nearest background behind it
CONTRAST = """selector => {
  const numbers = text => text.match(/[0-9.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map(c => c / 255)
    .map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    .reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = element => {
    for (; element; element = element.parentElement) {
      const colour = numbers(getComputedStyle(element).backgroundColor);
      if (colour.length < 4 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  return [...document.querySelectorAll(selector)].map(element => {
    const pair = [numbers(getComputedStyle(element).color), behind(element)].map(light).sort((a, b) => b - a);
    return (pair[0] + 0.05) / (pair[1] + 0.05);
  });
}"""


@pytest.mark.parametrize("path", ["/", "/jobs", "/docs"])
def test_a_guarded_service_asks_for_a_key_and_takes_it(served: Any, page: Any, path: str) -> None:
    key = served.service.keys.create("test")[0]
    page.goto(f"{served.url}{path}")
    expect(page.get_by_role("heading", name="Log in")).to_be_visible()
    page.locator("#key").fill("wrong")
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("alert")).to_have_text("This is no valid key.")
    page.locator("#key").fill(key)
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("heading", name="Jobs")).to_be_visible()
    assert page.evaluate("document.cookie") == ""
    page.get_by_role("button", name="Log out").click()
    expect(page.get_by_role("heading", name="Log in")).to_be_visible()


def test_devices_are_listed(served: Any, page: Any) -> None:
    page.goto(f"{served.url}/devices")
    expect(page.locator("tbody")).to_contain_text("A device of this test")


def test_the_api_is_described_without_raw_markup_and_leads_back(served: Any, page: Any) -> None:
    page.goto(f"{served.url}/jobs")
    page.get_by_role("link", name="API").click()
    expect(page.get_by_role("heading", name="POST /v1/jobs", exact=True)).to_be_visible()
    assert "`" not in page.locator("main").inner_text()
    page.locator("summary").first.click()
    expect(page.locator("details pre").first).to_contain_text('"camera"')
    page.get_by_role("link", name="Jobs", exact=True).click()
    expect(page.get_by_role("heading", name="Jobs")).to_be_visible()


@pytest.mark.parametrize("path", ["/jobs", "/submit", "/devices", "/docs", "/login", "/jobs/none"])
def test_nothing_comes_from_another_host(served: Any, page: Any, path: str) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(served.url + path)
    page.wait_for_load_state("load")
    assert asked
    assert all(url.startswith(served.url) for url in asked)
