"""`clbvh devices` and `doctor`: on this machine, and on machines that lack something.

The doctor touches drivers in processes of its own, so its command runs in this one.
"""

import json

import pytest

from clbvh import DeviceError, choose_device
from clbvh.conformance import check
from clbvh.conformance.expected import load_expected
from clbvh.device import doctor, select
from clbvh.device.driver_files import find_bundled_folder
from clbvh.device.host.targets import find_target

from .command import hidden_drivers, refuses, run_clbvh, run_process, shadowed_modules

NO_LOADER = "raise ImportError('libOpenCL.so.1: cannot open shared object file')\n"


class TestDevices:
    def test_the_table_and_the_json_object_describe_every_device(self, session):
        import pyopencl as cl

        host, *listed = json.loads(run_clbvh("devices", "--json").stdout)["devices"]
        assert (host["number"], host["platform"], host["kind"]) == (0, "host", "cpu")
        assert host["version"] in [f"level {level}" for level in find_target().levels]
        drivers_say = sorted(
            (" ".join(device.name.split()), device.global_mem_size, device.max_compute_units)
            for platform in cl.get_platforms()
            for device in platform.get_devices()
        )
        assert sorted((each["name"], each["memory_bytes"], each["compute_units"]) for each in listed) == drivers_say
        assert [each["number"] for each in listed] == list(range(1, 1 + len(listed)))
        listed = [host, *listed]
        assert [each["number"] for each in listed if each["is_default"]] == [choose_device().number]
        heading, *lines, footer = run_clbvh("devices").stdout.splitlines()
        assert footer.startswith("* used by default")
        assert heading.split() == ["device", "platform", "version", "driver", "memory", "units", "fp64", "layout"]
        for device, line in zip(listed, lines, strict=True):
            for fact in ("name", "kind", "platform", "driver_version", "layout"):
                assert device[fact] in line
        assert host["version"] in lines[0]

    def test_a_wrong_choice_in_the_environment_is_named_but_does_not_hide_the_list(self):
        answer = run_clbvh("devices", "--json", CLBVH_DEVICE="riva tnt")
        assert [each["is_default"] for each in json.loads(answer.stdout)["devices"]].count(True) == 0
        assert "'riva tnt' (asked for by CLBVH_DEVICE)" in answer.stderr

    def test_the_host_needs_no_opencl_and_one_line_says_what_that_lacks(self, tmp_path):
        environment = hidden_drivers(tmp_path)
        (tmp_path / "pyopencl.py").write_text(NO_LOADER)
        for lacking, words in (environment, "no OpenCL driver"), (shadowed_modules(tmp_path), "libOpenCL.so.1"):
            answer = run_process("devices", "--json", **lacking)
            report = json.loads(answer.stdout)
            assert (answer.returncode, [each["platform"] for each in report["devices"]]) == (0, ["host"])
            assert report["devices"][0]["is_default"]
            (problem,) = report["problems"]
            assert words in problem
            assert answer.stderr == f"clbvh: {problem}\n"
        picture = tmp_path / "out.ppm"
        words = ("render", "demo", "--width", 40, "--height", 30, "-o", picture)
        answer = run_process(*words, **shadowed_modules(tmp_path), PATH="")
        assert (answer.returncode, picture.exists()) == (0, True), answer.stderr
        # A folder that PoCL cannot make: below a file.
        answer = run_process("devices", "--json", POCL_CACHE_DIR=f"{environment['OCL_ICD_VENDORS']}/cache")
        problem = "the platform 'Portable Computing Language' offers no device"
        assert problem in json.loads(answer.stdout)["problems"]
        assert problem in answer.stderr

    def test_without_host_and_drivers_there_is_no_device(self, tmp_path, monkeypatch):
        def fail():
            raise DeviceError("the compiled kernels are missing")

        monkeypatch.setattr(select, "describe_host", fail)
        assert json.loads(run_clbvh("devices", "--json").stdout)["problems"] == ["the compiled kernels are missing"]
        monkeypatch.setattr(select, "_ask_platforms", lambda problems: [])
        words = "no device was found (the compiled kernels are missing)", "clbvh doctor"
        refuses(run_clbvh("devices"), 3, *words)
        refuses(run_process("devices", CLBVH_HOST_LEVEL="v1"), 2, "CLBVH_HOST_LEVEL=v1")


def diagnose(*arguments, run=run_clbvh, **environment):
    """Return the exit code, the report and the problems."""
    answer = run("doctor", "--json", *arguments, **environment)
    report = json.loads(answer.stdout)
    return answer.returncode, report, [each for each in report["findings"] if each["severity"] == "problem"]


class TestDoctor:
    def test_a_working_machine_is_exit_code_0(self, session):
        answer = run_clbvh("doctor")
        assert answer.returncode == 0, answer.stdout
        host, *_ = answer.stdout.splitlines()
        assert "computes correctly" in host
        assert f"{choose_device('host').version.split()[1]} runs here" in host
        assert "devices work" in answer.stdout.splitlines()[-1]
        code, report, _ = diagnose()
        assert (code, report["works"]) == (0, True)
        assert all(device["works"] and device["error"] == "" for device in report["devices"])
        assert [finding["check"] for finding in report["findings"][:2]] == ["host", "pyopencl"]

    def test_a_driver_file_that_names_a_missing_library_is_named_and_hides_pocl(self, tmp_path):
        environment = hidden_drivers(tmp_path)
        code, report, problems = diagnose(**environment)
        assert (code, report["works"], len(problems)) == (0, True, 1)
        message = f"{environment['OCL_ICD_VENDORS']} names 'libgone.so.7', which cannot be loaded"
        assert message in problems[0]["message"]
        # The loader takes a variable that names no folder for the only driver, PoCL or not.
        answer = run_clbvh("doctor", **environment)
        assert "        $ unset OCL_ICD_VENDORS" in answer.stdout.splitlines()
        assert any(line.startswith("note    no OpenCL driver") for line in answer.stdout.splitlines())
        assert answer.stdout.splitlines()[-1] == "1 of 1 devices work"

    def test_without_the_host_a_missing_driver_is_a_problem(self, tmp_path, monkeypatch):
        finding = doctor.Finding("host", "problem", "the compiled kernels are missing")
        monkeypatch.setattr(doctor, "_try_host", lambda timeout_s: (finding, []))
        code, report, problems = diagnose(**hidden_drivers(tmp_path))
        assert (code, report["works"], problems[0]["message"]) == (3, False, finding.message)
        assert any("no OpenCL driver" in problem["message"] for problem in problems)
        answer = run_clbvh("doctor", **hidden_drivers(tmp_path))
        assert answer.stdout.splitlines()[-1] == "0 of 0 devices work"
        assert answer.stderr.startswith("clbvh: no device works")

    def test_broken_drivers_beside_a_good_one_are_problems_but_no_failure(self, tmp_path):
        (tmp_path / "garbage.so").write_text("no library at all")
        for name, text in {"a": "", "b": f"{tmp_path}/garbage.so\n", "c": "libgone.so.7\n"}.items():
            (tmp_path / f"{name}.icd").write_text(text)
        # The loader inside pyopencl still finds the PoCL beside it; so does the doctor.
        code, _, problems = diagnose(OCL_ICD_VENDORS=str(tmp_path))
        assert code == 0
        found = [problem for problem in problems if problem["check"] == "driver file"]
        expected = ["a.icd cannot be read or is empty", "garbage.so', which cannot be loaded", "names 'libgone.so.7'"]
        for problem, words in zip(found, expected, strict=True):
            assert words in problem["message"]
            assert problem["advice"]

    def test_what_else_may_be_missing(self, tmp_path):
        (tmp_path / "file").touch()
        _, _, problems = diagnose(POCL_CACHE_DIR=str(tmp_path / "file/cache"))
        (problem,) = (problem for problem in problems if "offers no device" in problem["message"])
        assert any("POCL_CACHE_DIR" in line for line in problem["advice"])
        # The doctor itself looks for the folder of pyopencl.
        (tmp_path / "pyopencl.py").write_text(NO_LOADER)
        code, report, problems = diagnose(run=run_process, **shadowed_modules(tmp_path))
        assert (code, problems) == (0, [])
        (note,) = (finding for finding in report["findings"] if finding["check"] == "pyopencl")
        assert note["severity"] == "note"
        assert "$ pip install --force-reinstall --only-binary :all: pyopencl" in note["advice"]
        # PoCL's own brake: it sleeps that many seconds when it starts.
        code, _, problems = diagnose("--timeout", "5", POCL_STARTUP_DELAY="100")
        assert code == 0
        assert any("did not answer within 5 s" in problem["message"] for problem in problems)

    def test_stored_answers_are_equal_or_named(self, session, monkeypatch):
        answer = run_clbvh("doctor", "--conformance", "--device", "host", "--mesh", "single")
        assert answer.returncode == 0, answer.stderr
        assert "parts of the stored answers are equal" in answer.stdout
        digests, expected = load_expected()
        single = expected["single"]
        hits, counts = single["any_hit"]["is_hit"], single["count_hits"]["count"]
        single["any_hit"], single["count_hits"] = {"is_hit": counts}, {"count": hits}
        monkeypatch.setattr(check, "load_expected", lambda: (digests, expected))
        answer = run_clbvh("doctor", "--conformance", "--mesh", "single", "--json")
        report = json.loads(answer.stdout)
        assert (answer.returncode, report["is_equal"]) == (1, False)
        assert {each["query"] for each in report["differences"]} == {"any_hit", "count_hits"}
        assert "8 answers are not the stored ones; first bvh2, any_hit, mesh 'single': is_hit differs" in answer.stderr

    def test_fix_says_what_it_would_write_writes_it_and_has_nothing_to_do_then(self, tmp_path, monkeypatch):
        """PoCL is found that no driver file names."""
        pocl = next(iter(find_bundled_folder().glob("libpocl*")), None)
        if pocl is None:
            pytest.skip("this pyopencl has no PoCL beside it that could be found again")
        path, home = tmp_path / "own/pocl.icd", tmp_path / "home"
        home.mkdir()
        monkeypatch.setattr(
            doctor,
            "find_unregistered",
            lambda files: [] if path in [file.path for file in files] else [(pocl, path.name)],
        )
        environment = {"CLBVH_DRIVERS": str(path.parent), "HOME": str(home)}
        answer = run_clbvh("doctor", "--fix", "--dry-run", **environment)
        assert answer.returncode == 0, answer.stderr
        assert answer.stdout.startswith(f"would write {path} ({pocl}: ")
        assert not path.parent.exists()

        answer = run_clbvh("doctor", "--fix", **environment)
        assert answer.stdout.startswith(f"wrote {path} ({pocl}: ")
        assert f"to undo it: rm {path}" in answer.stdout
        assert path.read_text() == f"{pocl}\n"
        assert run_clbvh("doctor", "--fix", **environment).stdout.startswith("nothing to fix")
        refuses(run_clbvh("doctor", "--fix", OCL_ICD_VENDORS=str(tmp_path)), 2, "OCL_ICD_VENDORS is set", "unset it")
