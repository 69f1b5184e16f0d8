"""The front page, the citation file and the documentation: short, linked, and of this program."""

import doctest
import importlib.util
import re
import sys
from pathlib import Path

import pytest
import yaml
from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.cli.prepare_release import get_forthcoming_label

from tss_ros.core import LAW_PARAMETERS, TETHER_LAWS, compute_floquet
from tss_ros.runs import demo
from tss_ros.scenarios import scenario

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING")]
PAGES += [ROOT / "QUALITY_DECLARATION.md"]
PAGES += sorted(p for p in DOCS.rglob("*.md") if not {"_build", "_generated"} & set(p.parts))


def load(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


generate, update_readme = load("generate"), load("update_readme")

# ---------------------------------------------------------------- the front page


def test_readme_is_a_page():
    lines = README.splitlines()
    assert len(lines) <= 100
    assert [line for line in lines if len(line) > 120] == []


def test_readme_shows_an_animation_that_is_small():
    (name,) = re.findall(r"\((docs/\S+\.gif)\)", README)
    assert (ROOT / name).read_bytes()[:6] == b"GIF89a"
    assert (ROOT / name).stat().st_size < 600_000


def test_readme_shows_what_the_demo_computes():
    """The table in the README is of today's program: one of its rows is computed afresh."""
    block = README.partition(update_readme.BEGIN)[2].partition(update_readme.END)[0]
    rows = [
        re.split(r"  +", line.strip()) for line in block.splitlines() if re.match(r" +-\d", line)
    ]
    assert [row[0] for row in rows] == [f"{rate:g}" for rate in demo.RATES]
    system = scenario.load(demo.SCENARIO).build()
    for rate, row in list(zip(demo.RATES, rows))[4:6]:
        result = compute_floquet(system, float(rate), certify=False)
        family, modulus = row[3].rsplit(" ", 1)
        assert float(row[1]) == pytest.approx(result.period_s, abs=0.06)
        assert family == result.deciding_family
        assert float(modulus) == pytest.approx(result.deciding_modulus, abs=2e-6)
        assert row[4] == result.verdict
        assert row[5] == result.tether_law
        assert float(row[6].rstrip("%")) == pytest.approx(100.0 * result.pushing_share, abs=0.06)


def test_demo_output_is_cut_out_of_a_log():
    log = "tss_ros: done\nturn 1\n\n rate/Omega  x\n      -1.5  1\n\nfirst line.\nsecond\n"
    log += "\nruns/demo/bag\n"
    assert update_readme.results(log) == [
        " rate/Omega  x",
        "      -1.5  1",
        "",
        "first line.",
        "second",
    ]


def test_python_of_the_front_page_runs():
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len(code.splitlines()) == 6
    names = {}
    exec(code, names)
    assert names["result"].verdict == "asymptotically stable"
    assert names["position_m"].shape == (3, 3, 3)


@pytest.mark.parametrize(
    ("page", "verdict"),
    # Nothing damps the bending of a straight chain out of the orbit plane.
    [("tutorial.md", "asymptotically stable"), ("howto/scenario.md", "neutral")],
)
def test_python_of_the_pages_runs(page, verdict, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in re.findall(r"```python\n(.*?)```", (DOCS / page).read_text("utf-8"), re.S):
        exec(code, names)
    assert names["result"].verdict == verdict


class SizesAside(doctest.OutputChecker):
    """Of errors the place of the first digit counts, not the digits: they are rounding."""

    def check_output(self, want, got, flags):
        want, got = (re.sub(r"\d\.\de-(1\d)", "error", text) for text in (want, got))
        return super().check_output(want, got, flags)


def test_a_notebook_shows_what_its_page_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (DOCS / "howto" / "notebook.md").read_text("utf-8")
    test = doctest.DocTestParser().get_doctest(page, {}, "notebook.md", "notebook.md", 0)
    assert len(test.examples) > 15
    said = []
    options = doctest.REPORT_NDIFF
    doctest.DocTestRunner(SizesAside(), verbose=False, optionflags=options).run(
        test, out=said.append
    )
    assert "".join(said) == ""


# ---------------------------------------------------------------- links and places


def prose(path):
    """A page without its code blocks."""
    return re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.S | re.M)


def made_by_sphinx(path):
    return bool({"_generated", "gallery"} & set(path.parts)) and DOCS in path.parents


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_relative_link_leads_to_a_file(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    relative = [t.partition("#")[0] for t in targets if not re.match(r"[a-z]+:|#", t)]
    paths = [(page.parent / target).resolve() for target in relative]
    assert [p for p in paths if not p.exists() and not made_by_sphinx(p)] == []


def test_links_were_found():
    links = sum(len(re.findall(r"\]\(([^)\s]+)\)", prose(page))) for page in PAGES)
    assert len(PAGES) > 25 and links > 40


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_source_file_named_in_a_page_exists(page):
    text = page.read_text(encoding="utf-8")
    folders = "tss_ros|tests|docs|benchmarks|setup_tools|msg_configs|config|examples|requirements"
    named = set(re.findall(rf"`((?:{folders})/[\w/]+\.(?:py|md|yaml|yml|txt))`", text))
    if page.name == "architecture.md":
        in_table = re.findall(r"`([a-z_]+(?:/[\w]+)+\.py)`", text)
        named |= {n if (ROOT / n).exists() else f"tss_ros/{n}" for n in in_table}
        assert len(named) > 15
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


# ---------------------------------------------------------------- generated parts


def test_equations_are_found_where_they_are_computed():
    places = {}
    for c in generate.citations():
        if not c.in_range:
            places.setdefault(c.number, set()).add((c.path.parent.name, c.name.split(".")[0]))
    assert ("model", "tether_state") in places[3] & places[5]
    assert {folder for folder, _ in places[26]} == {"stability"}
    assert "stability" in {folder for folder, _ in places[34]}
    assert "model" in {folder for folder, _ in places[51]}
    rows = generate.equations().splitlines()[2:]
    assert len(rows) == len(generate.EQUATIONS) == 54
    for number in (3, 5, 26, 34, 51):
        row = next(row for row in rows if row.startswith(f"| ({number}) |"))
        assert ".py`" in row.split(" | ")[2]


def test_citations_are_read_from_docstrings_and_comments_only(tmp_path):
    (tmp_path / "law.py").write_text(
        '"""Eqs. (1), (2) and (4)."""\n'
        "class A:\n"
        "    def f(self):\n"
        '        """Tension, Eqs.\n        (12)-(14); see (99)."""\n'
        '        return "Eq. (77)"  # Eq. (5)\n'
    )
    found = {(c.number, c.name, c.line, c.in_range) for c in generate.citations(tmp_path)}
    assert found == {
        (1, "", 1, False),
        (2, "", 1, False),
        (4, "", 1, False),
        (12, "A.f", 4, False),
        (13, "A.f", 4, True),
        (14, "A.f", 4, False),
        (5, "A.f", 6, False),
    }


def test_every_parameter_topic_and_interface_has_its_row():
    from tss_ros.ros import parameters
    from tss_ros.ros.topics import read_topics

    table = generate.parameters()
    for parameter in (*parameters.SIMULATOR, *parameters.STABILITY, *parameters.LOGGER):
        assert f"| `{parameter.name}` |" in table
    assert all(f"`{law.name}`" in table and law.meaning in table for law in TETHER_LAWS)
    assert all(f"| `{p.name}` | {p.meaning}" in table for p in LAW_PARAMETERS)
    assert all(f"| `{name}` |" in generate.topics() for name in read_topics())
    assert "`~/compute_floquet`" in generate.services() and "`~/sweep`" in generate.actions()
    offered = generate.offered("srv") + generate.offered("action")
    assert {node for node, _, _ in offered} == {"sim_node", "stability_node"}
    compared = [line for line in generate.simulation_interfaces().splitlines() if "`" in line]
    assert len(compared) > 100 and not [line for line in compared if "|  |" in line]


def test_every_module_says_what_it_holds():
    rows = [line for line in generate.tree().splitlines() if line.startswith("| `")]
    assert len(rows) > 40
    assert [row for row in rows if re.fullmatch(r"\| `.*` \|\s*\|", row)] == []


def test_api_page_lists_all_public_names():
    from tss_ros import core

    page = generate.python_api()
    assert [n for n in core.__all__ if not re.search(rf"^(   |\.\. data:: ){n}$", page, re.M)] == []


# ---------------------------------------------------------------- citation and changelog


def test_citation_names_software_and_paper():
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cff["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "version", "license"} <= cff.keys()
    assert cff["version"] == re.search(r'version="(.*)"', (ROOT / "setup.py").read_text())[1]
    (paper,) = cff["references"]
    assert {"type", "title", "authors"} <= paper.keys()
    assert paper["doi"] == "10.1007/s11071-022-07466-8"
    for entity in cff["authors"] + paper["authors"]:
        assert entity["name"]
    assert paper["doi"] in README and paper["title"] in README


def test_changelog_is_read_by_the_tools_of_ros():
    """As catkin_prepare_release does: the forthcoming version gets its number and its date."""
    text = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    assert get_forthcoming_label(text) == "Forthcoming"
    title = "0.1.0 (2027-01-01)"
    dated = re.sub("^Forthcoming\n-+$", f"{title}\n{'-' * len(title)}", text, flags=re.M)
    changelog = populate_changelog_from_rst(Changelog("tss_ros"), dated)
    ((version, _, content),) = changelog.foreach_version()
    bullets = [bullet for part in content for bullet in getattr(part, "bullets", [])]
    assert version == "0.1.0" and len(bullets) == len(re.findall(r"^\* ", text, re.M)) > 40
    assert not re.search(r"(?<!`)`[^`]", text)  # one backtick is no literal


def test_old_names_of_jobs_stand_in_the_changelog():
    from tss_ros.core.api import OLD_NAMES

    text = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    for old, new in OLD_NAMES.items():
        assert f"`{new.__name__}`" in text and re.search(rf"`(tss_ros\.core\.)?{old}`", text)
