"""The list of planted bugs is that of the files as they are; `make mutants` plants them."""

from tests.mutants.__main__ import ROOT, planted


def test_each_bug_has_one_place() -> None:
    found = planted()
    assert len(found) > 500
    for bug in found:
        text = (ROOT / "mbdlft" / bug.file).read_text(encoding="utf-8")
        assert text.count(bug.old) == 1, f"{bug.file}: {bug.old}"
        assert bug.new != bug.old
        for file in bug.tests.split():
            assert (ROOT / "tests" / file.partition("::")[0]).exists(), file
