"""`clbvh doctor` on this machine and on machines that lack something.

The doctor touches drivers in processes of its own, so the command itself can run in this one.
"""

import json
import re

import pytest

from clbvh.conformance import check
from clbvh.conformance.expected import load_expected
from clbvh.device import doctor
from clbvh.device.driver_files import find_bundled_folder

from .command import hidden_drivers, refuses, run_clbvh, run_process, shadowed_modules


def run_doctor(*arguments, **environment):
    return run_clbvh("doctor", *arguments, **environment)


def findings_of(answer, severity):
    return [finding for finding in json.loads(answer.stdout)["findings"] if finding["severity"] == severity]


def test_a_working_machine_is_exit_code_0():
    answer = run_doctor()
    assert answer.returncode == 0, answer.stdout
    assert "computes correctly" in answer.stdout
    assert "devices work" in answer.stdout.splitlines()[-1]


def test_the_json_object_agrees_with_the_text():
    answer = run_doctor("--json")
    assert answer.returncode == 0
    report = json.loads(answer.stdout)
    assert report["works"] is True
    assert any(device["works"] and device["error"] == "" for device in report["devices"])
    assert {finding["severity"] for finding in report["findings"]} <= {"ok", "note", "problem"}
    assert "pyopencl" in report["findings"][0]["message"]


def test_a_driver_file_that_names_a_missing_library_is_named_and_hides_pocl(tmp_path):
    environment = hidden_drivers(tmp_path)
    icd = environment["OCL_ICD_VENDORS"]
    answer = run_doctor("--json", **environment)
    assert answer.returncode == 3
    assert json.loads(answer.stdout)["works"] is False
    problems = findings_of(answer, "problem")
    assert f"{icd} names 'libgone.so.7', which cannot be loaded" in problems[0]["message"]
    # The loader takes a variable that names no folder for the only driver, PoCL or not.
    (note,) = [finding for finding in findings_of(answer, "note") if finding["check"] == "loader"]
    assert "$ unset OCL_ICD_VENDORS" in note["advice"]


def test_the_text_has_each_command_on_a_line_of_its_own_and_ends_with_exit_code_3(tmp_path):
    answer = run_doctor(OCL_ICD_VENDORS=str(tmp_path / "a rather long name of a folder that is not there"))
    assert answer.returncode == 3
    assert "        $ unset OCL_ICD_VENDORS" in answer.stdout.splitlines()
    assert answer.stdout.splitlines()[-1] == "0 of 0 devices work"
    (line,) = answer.stderr.splitlines()
    assert line.startswith("clbvh: no OpenCL device works")


def test_broken_drivers_beside_a_good_one_are_problems_but_no_failure(tmp_path):
    (tmp_path / "garbage.so").write_text("no library at all")
    (tmp_path / "a.icd").write_text("")
    (tmp_path / "b.icd").write_text(f"{tmp_path}/garbage.so\n")
    (tmp_path / "c.icd").write_text("libgone.so.7\n")
    answer = run_doctor("--json", OCL_ICD_VENDORS=str(tmp_path))
    # The loader inside pyopencl still finds the PoCL beside it; so does the doctor.
    assert answer.returncode == 0
    problems = [finding for finding in findings_of(answer, "problem") if finding["check"] == "driver file"]
    expected = ["a.icd cannot be read or is empty", "garbage.so', which cannot be loaded", "names 'libgone.so.7'"]
    for problem, words in zip(problems, expected, strict=True):
        assert words in problem["message"]
        assert problem["advice"]


def test_pocl_without_a_folder_to_write_to_is_told_apart_from_no_pocl(tmp_path):
    (tmp_path / "file").touch()
    answer = run_doctor("--json", POCL_CACHE_DIR=str(tmp_path / "file/cache"))
    (problem,) = [finding for finding in findings_of(answer, "problem") if "offers no device" in finding["message"]]
    assert any("POCL_CACHE_DIR" in line for line in problem["advice"])


def test_pyopencl_without_a_loader_is_exit_code_3(tmp_path):
    broken = "raise ImportError('libOpenCL.so.1: cannot open shared object file')\n"
    (tmp_path / "pyopencl.py").write_text(broken)
    # The doctor itself looks for the folder of pyopencl.
    answer = run_process("doctor", "--json", **shadowed_modules(tmp_path))
    assert answer.returncode == 3
    problem = findings_of(answer, "problem")[0]
    assert problem["check"] == "pyopencl"
    assert "libOpenCL.so.1: cannot open shared object file" in problem["message"]
    assert "$ pip install --force-reinstall --only-binary :all: pyopencl" in problem["advice"]


def test_a_driver_that_hangs_is_given_up_after_the_timeout():
    # PoCL's own brake: it sleeps that many seconds when it starts.
    answer = run_doctor("--json", "--timeout", "1.5", POCL_STARTUP_DELAY="100")
    assert answer.returncode == 3
    assert any("did not answer within 1.5 s" in finding["message"] for finding in findings_of(answer, "problem"))


def test_a_device_with_the_stored_answers_conforms():
    answer = run_doctor("--conformance", "--mesh", "single")
    assert answer.returncode == 0, answer.stderr
    count, total = re.search(r"(\d+) of (\d+) parts of the stored answers are equal", answer.stdout).groups()
    assert int(count) == int(total) > 0


def test_other_answers_are_exit_code_1_and_named(monkeypatch):
    digests, expected = load_expected()
    expected["single"]["any_hit"], expected["single"]["count_hits"] = (
        {"is_hit": expected["single"]["count_hits"]["count"]},
        {"count": expected["single"]["any_hit"]["is_hit"]},
    )
    monkeypatch.setattr(check, "load_expected", lambda: (digests, expected))
    answer = run_doctor("--conformance", "--mesh", "single", "--json")
    assert answer.returncode == 1
    report = json.loads(answer.stdout)
    assert report["is_equal"] is False
    assert {(difference["query"], difference["mesh"]) for difference in report["differences"]} == {
        ("any_hit", "single"),
        ("count_hits", "single"),
    }
    (line,) = answer.stderr.splitlines()
    assert "6 answers are not the stored ones; first bvh2, any_hit, mesh 'single': is_hit differs" in line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--device", "cpu"], "need --conformance"),
        (["--mesh", "soup"], "need --conformance"),
        (["--conformance", "--mesh", "bunny"], "'bunny' is no mesh"),
    ],
)
def test_options_of_the_check_without_sense_are_exit_code_2(arguments, words):
    refuses(run_doctor(*arguments), 2, words)


@pytest.fixture
def loose_driver(monkeypatch):
    """A machine on which PoCL is found that no driver file names; returns the path of its library."""
    pocl = next(iter(find_bundled_folder().glob("libpocl*")), None)
    if pocl is None:
        pytest.skip("this pyopencl has no PoCL beside it that could be found again")

    def find_unregistered(files):
        return (
            []
            if any(file.path.name == "pocl.icd" and file.path.parent.name == "own" for file in files)
            else [(pocl, "pocl.icd")]
        )

    monkeypatch.setattr(doctor, "find_unregistered", find_unregistered)
    return pocl


def test_fix_says_what_it_would_write_writes_it_and_has_nothing_to_do_then(loose_driver, tmp_path):
    path = tmp_path / "own/pocl.icd"
    answer = run_doctor("--fix", "--dry-run", CLBVH_DRIVERS=str(path.parent))
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith(f"would write {path} ({loose_driver}: ")
    assert not path.parent.exists()

    answer = run_doctor("--fix", CLBVH_DRIVERS=str(path.parent))
    assert answer.stdout.startswith(f"wrote {path} ({loose_driver}: ")
    assert f"to undo it: rm {path}" in answer.stdout
    assert path.read_text() == f"{loose_driver}\n"
    # The diagnosis that follows has it already.
    assert f"{path} names {loose_driver}" in answer.stdout

    answer = run_doctor("--fix", CLBVH_DRIVERS=str(path.parent))
    assert answer.stdout.startswith("nothing to fix")


def test_fix_touches_nothing_but_its_own_folder(loose_driver, tmp_path):
    own, home = tmp_path / "own", tmp_path / "home"
    home.mkdir()
    report = json.loads(run_doctor("--fix", "--json", HOME=str(home), CLBVH_DRIVERS=str(own)).stdout)
    assert report["dry_run"] is False
    assert [step["action"] for step in report["steps"]] == ["write"]
    # Drivers keep compiled kernels in the user's cache, whoever runs them.
    made = [path for path in tmp_path.rglob("*") if path.is_file() and ".cache" not in path.parts]
    assert made == [own / "pocl.icd"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--dry-run"], "--dry-run needs --fix"), (["--fix", "--conformance"], "give one of them")],
)
def test_options_of_the_fix_without_sense_are_exit_code_2(arguments, words):
    refuses(run_doctor(*arguments), 2, words)


def test_fix_under_a_variable_that_names_the_drivers_is_exit_code_2(tmp_path):
    refuses(run_doctor("--fix", OCL_ICD_VENDORS=str(tmp_path)), 2, "OCL_ICD_VENDORS is set", "unset it")
