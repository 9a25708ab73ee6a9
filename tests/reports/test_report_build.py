import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from stored_runs import ESTIMATOR, SCENARIO, pose_error, seal

from boresight.reports.figures.named import NamedFigure, with_trial_counts
from boresight.reports.figures.pose import draw_landmark_counts
from boresight.reports.pages.build import write_report
from boresight.reports.pages.content import read_content
from boresight.reports.run.data import read_run
from boresight.scenarios.errors import BoresightError

VOID = {"meta", "img", "br", "link", "hr", "input"}


class Page(HTMLParser):
    """Collects tags, attributes and text, and checks that tags nest."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.open = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def _page(files):
    return Page(files.html.read_text(encoding="utf-8"))


def test_report_holds_every_table_and_figure(report):
    files = report
    assert files.folder.name == "report"
    assert sorted(p.name for p in files.tables) == ["failures.csv", "table.csv", "timings.csv"]
    stems = {p.stem for p in files.figures}
    assert stems == {
        "pose_errors_itokawa_landmark-harris",
        "landmark_errors_itokawa_landmark-harris",
        "landmark_counts_itokawa_landmark-harris",
        "cumulative_errors_itokawa",
    }
    written = {*files.tables, *files.figures, files.html, files.markdown}
    assert {path for path in files.folder.rglob("*") if path.is_file()} == written


@pytest.mark.usefixtures("undrawn")
def test_figures_are_pdf_on_request_and_none_of_an_earlier_report_is_left(full_run):
    run = full_run()
    asked = write_report(run, pdf=True)
    assert {path.suffix for path in asked.figures} == {".png", ".pdf"}
    assert {path.with_suffix(".png") for path in asked.figures} == {p for p in asked.figures if p.suffix == ".png"}
    files = write_report(run)
    assert {path.suffix for path in files.figures} == {".png"}
    assert not list(files.folder.glob("*.pdf"))


def test_captions_say_of_how_many_trials_a_figure_is(report):
    """Six of the 120 trials failed."""
    text = report.markdown.read_text(encoding="utf-8")
    captions = re.findall(r"^!\[.*\]\(.*\)\n\n(.*)$", text, re.M)
    assert len(captions) == 4
    assert all(caption.endswith(". Of 120 trials, solved: prior 120, landmark-harris 114.") for caption in captions)


def test_captions_of_many_methods_give_the_range(builder):
    for estimator in map(str, range(8)):
        for trial in range(3):
            final = ((1.0, 2.0, 3.0), 0.1) if trial or estimator == "0" else None
            builder.trial(trial, ((9.0, 9.0, 9.0), 1.0), final, estimator=estimator)
    run = read_run(builder.write(estimators=list(map(str, range(8)))))
    told = with_trial_counts(NamedFigure("stem", Figure(), "What it shows.", ""), [run]).caption
    assert told == "What it shows. Of 3 trials, solved: 2 to 3 by each of 8 methods."


def test_csv_carries_the_numbers_behind_the_tables(report):
    files = report
    table = pd.read_csv(files.folder / "table.csv")
    rows = pd.read_parquet(files.folder.parent / "rows")
    ok = rows[(rows["estimator"] == "landmark-harris") & (rows["status"] == "ok")]
    (line,) = table[(table["published"] == 20.9)].to_dict("records")
    assert line["value"] == pytest.approx(ok["position_error_m"].median())
    assert line["low"] < line["value"] < line["high"]
    assert (line["n_ok"], line["n"], line["place"]) == (114, 120, "section 4.2.1")
    assert "seconds" not in set(table["measure"])
    assert set(pd.read_csv(files.folder / "timings.csv")["measure"]) == {"seconds"}
    assert len(pd.read_csv(files.folder / "failures.csv")) == 6


def test_page_is_self_contained_and_accessible(report):
    files = report
    page = _page(files)
    assert [script.get("src") for script in page.all("script")] == [None]
    assert not page.all("link")
    assert not page.all("a"), "nor does it lead to a file that may be left behind"
    images = page.all("img")
    assert len(images) == len(files.figures)
    assert all(i["src"].startswith("data:image/png;base64,") and len(i["alt"]) > 20 for i in images)
    css = files.html.read_text(encoding="utf-8").split("<style>")[1].split("</style>")[0]
    assert not re.search(r"url\(|@import|https?:", css)
    assert page.all("html")[0]["lang"] == "en"
    assert all(th["scope"] == "col" for th in page.all("th"))


def card_of(files):
    (first, *_) = re.findall(r"<dl>(.*?)</dl>", files.html.read_text(encoding="utf-8"), re.S)
    return dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", first))


@pytest.mark.usefixtures("undrawn")
def test_the_card_has_the_result_of_each_estimator(report, builder):
    rows = pd.read_parquet(report.folder.parent / "rows").query("estimator == 'landmark-harris'")
    won = int((rows["position_error_m"] <= rows["prior_position_error_m"]).sum())
    median, prior = rows["position_error_m"].median(), rows["prior_position_error_m"].median()
    found = re.fullmatch(
        r"landmark-harris: solved (\d+)/120, success (\d+)/120, median position error ([\d.]+) \[([\d.]+),"
        r" ([\d.]+)\] m, prior ([\d.]+) m",
        card_of(report)["Result"],
    )
    assert [int(found[1]), int(found[2])] == [int(rows["position_error_m"].notna().sum()), won]
    assert [float(found[3]), float(found[6])] == pytest.approx([median, prior], abs=0.06)
    assert float(found[4]) < median < float(found[5])
    for label in ("one", "two", "three"):
        builder.trial(0, ((9.0, 9.0, 9.0), 1.0), ((1.0, 2.0, 3.0), 0.1), estimator=label)
    assert (
        card_of(write_report(builder.write(estimators=["one", "two", "three"])))["Result"].count(
            "solved 1/1, success 1/1"
        )
        == 3
    )
    builder.trial(0, ((9.0, 9.0, 9.0), 1.0), None, estimator="four")
    files = write_report(builder.write(estimators=["one", "two", "three", "four"]))
    assert card_of(files)["Result"] == "4 estimators: see the table"


def test_the_card_counts_solved_trials_where_there_is_no_prior(builder):
    nothing = {f"{prefix}{name}": np.nan for prefix in ("", "prior_") for name in pose_error(np.zeros(3), 0)}
    for trial in range(3):
        key = {"trial": trial, "scenario": SCENARIO, "estimator": "base"}
        builder.add("rows", **key, **nothing, status="ok" if trial else "failed", reason="", image="", n_landmarks=9)
        if trial:
            builder.add("diagnostics", **key, name="landmarks", value=100.0 * trial)
    files = write_report(builder.write(estimators=["base"], report=None, campaign={"experiment": "landmark-database"}))
    assert card_of(files)["Result"] == "base: solved 2/3, median landmarks in the data base 150"


def titles_and_pictures(files):
    """List the headings of the page and the stems of its pictures in their order."""
    text = files.html.read_text(encoding="utf-8")
    return re.findall(r'<h2[^>]*>(.*?)</h2>|<img src="data:[^"]*" alt="([^"]*)">', text)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("typical", [True, False])
def test_the_first_picture_comes_after_the_first_table(full_run, report, typical):
    lead = (
        [NamedFigure("typical", draw_landmark_counts(np.arange(9.0), "T"), "A trial.", "the lead")] if typical else []
    )
    order = titles_and_pictures(write_report(full_run(), extra=lead) if typical else report)
    headings = [title for title, _ in order]
    assert headings[0].startswith("Pose error")
    assert headings[1] == "", "a picture"
    assert (order[1][1] == "the lead") == typical, "the first figure takes the place of one"
    assert headings.index("Beside the published values") > 1
    pictures = [alt for _, alt in order if alt]
    assert len(pictures) == len(set(pictures)) == 4 + typical


@pytest.mark.usefixtures("undrawn")
def test_a_long_first_table_comes_after_the_first_picture(builder):
    for estimator in map(str, range(9)):
        for trial in range(3):
            builder.trial(trial, ((9.0, 9.0, 9.0), 1.0), ((1.0, 2.0, 3.0), 0.1), estimator=estimator)
    order = titles_and_pictures(write_report(builder.write(estimators=list(map(str, range(9))), report=None)))
    assert [bool(alt) for _, alt in order[:2]] == [True, False]


def test_page_says_what_was_run_and_escapes_it(unfinished):
    text = "".join(_page(unfinished).text)
    assert "Landmarks on <Itokawa>" in text
    assert "abc123" in text
    assert "boresight run x --set 'a=<b>'" in text
    assert "3 landmarks | 4 are needed" in text
    assert "section 4.2.1" in text
    assert "<Itokawa>" not in unfinished.html.read_text(encoding="utf-8")


def test_page_reproduces_by_name_seed_and_trials_where_no_command_is_stored(report):
    text = "".join(_page(report).text)
    assert "boresight run rowell2015-simulated --trials 120 --seed 7" in text


def test_unfinished_run_says_so(unfinished, report):
    assert "Unfinished: 120 of 6000 trials" in "".join(_page(unfinished).text)
    assert "120 of 6000 trials" in unfinished.markdown.read_text()
    assert "Unfinished" not in "".join(_page(report).text)


def test_credit_lines_stand_under_every_figure_and_at_the_end(unfinished):
    credit, page = "ESA/Rosetta/NAVCAM, CC BY", _page(unfinished)
    assert "".join(page.text).count(credit) == len(page.all("figure")) + 1
    assert credit in unfinished.markdown.read_text()


def test_what_is_not_stored_is_left_out_and_said(builder):
    for trial in range(3):
        builder.trial(trial, ([3, 4, 0], 1), ([1, 1, 0], 1))
    files = write_report(builder.write())
    assert not [p for p in files.figures if p.stem.startswith("landmark_errors")]
    assert "left out: stages, landmarks, timings" in files.markdown.read_text()
    assert "Time per stage" not in files.markdown.read_text()


@pytest.mark.usefixtures("undrawn")
def test_notes_on_poses_stand_where_there_are_poses(builder, full_run, report):
    about, absent = "components turned into the true camera's axes", "so left out"
    assert about in report.markdown.read_text(encoding="utf-8")
    full_run()
    file = builder.folder / "rows" / "block-0.parquet"
    rows = pd.read_parquet(file)
    nothing = [name for name in rows if "_error" in name]
    rows[rows["estimator"] == "prior"].assign(**dict.fromkeys(nothing, np.nan)).to_parquet(file)
    notes = read_content(seal(builder.folder)).notes
    assert not any(about in note or absent in note for note in notes)


@pytest.mark.usefixtures("undrawn")
def test_a_control_character_of_a_stored_text_reaches_no_file_of_a_report(builder):
    steering = "\x1b[2Jsteering"
    for trial in range(3):
        builder.trial(trial, ([3, 4, 0], 1), ([1, 1, 0], 1) if trial else None, reason="" if trial else steering)
        key = {"trial": trial, "scenario": SCENARIO, "estimator": ESTIMATOR}
        builder.add("stages", **key, stage=steering, **pose_error([1, 1, 0], 1))
        builder.add("diagnostics", **key, name=steering, value=1.0)
        builder.add("timings", **key, stage=steering, seconds=1.0)
    folder = write_report(builder.write()).markdown.parent
    texts = [path.read_text() for path in folder.rglob("*") if path.suffix in (".md", ".html", ".csv", ".json")]
    assert len(texts) > 3
    assert not any("\x1b" in text for text in texts)
    assert sum(r"\x1b[2Jsteering" in text for text in texts) >= 3


@pytest.mark.usefixtures("undrawn")
def test_texts_of_a_manifest_cannot_steer_a_terminal_or_the_markup_of_a_report(builder):
    for trial in range(3):
        builder.trial(trial, ([3, 4, 0], 1), ([1, 1, 0], 1))
    foreign = {
        "description": "a\x1b[2Jb",
        "command": "boresight \x1b[2J",
        "notes": ["n\x1b[2J"],
        "credits": ["c\x1b[2J"],
    }
    title = "<b>bold</b>\n# [link](x) `code` \x1b[2J *a_b*"
    folder = write_report(builder.write(title=title, **foreign)).markdown.parent
    assert not any("\x1b" in path.read_text() for path in folder.rglob("*") if path.suffix in (".md", ".html"))
    heading, _ = (folder / "report.md").read_text(encoding="utf-8").split("\n", maxsplit=1)
    assert heading == r"# \<b\>bold\</b\> # \[link\](x) \`code\` \\x1b\[2J \*a\_b\*"


def test_a_run_in_which_everything_failed_is_still_reported(builder):
    builder.trial(0, ([3, 4, 0], 1), None, reason="black image")
    files = write_report(builder.write(report="rowell2015-simulated"))
    text = "".join(_page(files).text)
    assert "black image" in text
    assert "not measured" in text


def test_further_figures_are_shown_after_those_of_the_tables(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 1, 0], 1))
    counts = draw_landmark_counts(np.arange(5.0), "T")
    further = NamedFigure("fit_image7", counts, "The fit of image 7.", "Three panels with the stages of a fit.")
    files = write_report(builder.write(), extra=[further])
    assert "fit_image7.png" in {p.name for p in files.figures}
    assert _page(files).all("img")[-1]["alt"] == further.alt
    assert "![Three panels with the stages of a fit.](fit_image7.png)" in files.markdown.read_text()


def test_no_figure_takes_the_place_of_another(builder):
    builder.trial(0, ([3, 4, 0], 1), ([1, 1, 0], 1))
    again = NamedFigure("fit_image7", draw_landmark_counts(np.arange(5.0), "T"), "", "")
    with pytest.raises(ValueError, match="two figures are called fit_image7"):
        write_report(builder.write(), extra=[again, again])


def test_same_rows_give_the_same_bytes(report, tmp_path):
    first, second = report, write_report(report.folder.parent, tmp_path / "b")
    assert _contents(first.folder) == _contents(second.folder)


def test_failed_writing_leaves_the_former_report_untouched(report, tmp_path, monkeypatch):
    run, out = report.folder.parent, tmp_path / "out"
    shutil.copytree(report.folder, out)
    (out / "mine.txt").write_text("kept")
    before = _contents(out)

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("boresight.reports.pages.build.save_figure", full_disk)
    with pytest.raises(BoresightError, match="No space left on device"):
        write_report(run, out)
    assert _contents(out) == before


def _contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_out_that_is_a_file_is_refused(full_run, tmp_path):
    out = tmp_path / "out"
    out.write_text("a file")
    with pytest.raises(BoresightError, match="cannot be written"):
        write_report(full_run(), out)
    assert out.read_text() == "a file"


def test_unknown_published_values_are_refused_before_anything_is_written(full_run):
    run = full_run(report="rowell2016")
    with pytest.raises(BoresightError, match="rowell2016"):
        write_report(run)
    assert not (run / "report").exists()
