"""Reading run folders: the returned values, and the message for each kind of unreadable folder."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.errors import FileError
from cell.runs.run import execution_of, open_run, read_execution, read_scan

Blob = Callable[[int], trimesh.Trimesh]


@pytest.fixture
def copy(planned: Path, tmp_path: Path) -> Path:
    """Return a copy of the finished run that a test may damage."""
    return Path(shutil.copytree(planned, tmp_path / "copy"))


def _manifest(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_the_parts_agree_with_each_other(planned: Path) -> None:
    """Views, motion, candidates and reach of one run have the same poses."""
    run = open_run(planned)
    views, motion = run.plan.views, run.motion
    candidates, reached = run.candidates, run.reach
    assert run.is_finished
    assert [view.id for view in views] == motion.view[motion.view >= 0].tolist()
    T_base_object = run.scene.T_base_object
    for view, q in zip(views, motion.via_q[motion.view >= 0], strict=True):
        np.testing.assert_allclose(view.q, q, atol=1e-12)
        assert np.isclose(reached.configurations_of(view.id), view.q, atol=1e-9).all(axis=1).any()
        np.testing.assert_allclose(view.T_base_scanner, T_base_object @ view.T_object_scanner, atol=1e-12)
        np.testing.assert_allclose(view.T_object_scanner, candidates.T_object_scanner[view.id, 0], atol=2e-5)


def test_the_reference_is_the_part_that_was_given(planned: Path, blob: Blob) -> None:
    """Volume and bounds of reference.ply are those of the part, in metres (the part is a float32 STL)."""
    reference, part = open_run(planned).mesh("reference.ply"), blob(4)
    assert len(reference.faces) == len(part.faces)
    np.testing.assert_allclose(reference.vertices.min(axis=0), part.vertices.min(axis=0) / 1000, atol=1e-8)
    read = trimesh.Trimesh(reference.vertices, reference.faces, process=False)
    assert read.volume == pytest.approx(part.volume / 1e9, rel=1e-6)


def test_invalid_folders_have_different_messages(tmp_path: Path, copy: Path) -> None:
    """A missing, foreign or damaged folder, a file and another schema have one message each, with exit code 6."""
    foreign, empty, several = (tmp_path / name for name in ("foreign", "empty", "several"))
    for folder in (foreign, empty, several):
        folder.mkdir()
    for name in ("manifest.json", "setups.json"):
        (several / name).write_text("{}")
    (foreign / "manifest.json").write_text('{"name": "a web page"}')
    (tmp_path / "gone.part").mkdir()
    sentences = {
        tmp_path
        / "nothing": "does not exist; give the folder that cell plan made; run folders next to it: copy, foreign",
        tmp_path / "gone": "gone.part does: a run that did not finish",
        copy / "cell.xml": "is a file",
        empty: "has no manifest.json",
        several: "holds several set-ups; give the run folder of one of them: none is there",
        foreign: "is not a run folder: its manifest.json does not have the schema",
    }
    for folder, sentence in sentences.items():
        with pytest.raises(FileError, match=r"^[^\n]+$") as caught:
            open_run(folder)
        assert sentence in str(caught.value)
    _manifest(copy, schema="scan-cell/run/9")
    with pytest.raises(FileError, match=r"has the schema scan-cell/run/9, and this version of scan-cell reads"):
        open_run(copy)
    (copy / "manifest.json").write_text('{"schema": ')
    with pytest.raises(FileError, match=r"manifest\.json is damaged: it is not JSON"):
        open_run(copy)


def test_the_folder_of_an_execution_is_known_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also from inside the run, where its path is short."""
    folder = tmp_path / "run" / "executions" / "0001"
    folder.mkdir(parents=True)
    assert execution_of(Path("run/executions/0001")) == (Path("run"), "0001")
    assert execution_of(tmp_path / "run") is None
    for place, path in ((tmp_path / "run", "executions/0001"), (folder.parent, "0001"), (folder, ".")):
        monkeypatch.chdir(place)
        run, name = execution_of(Path(path)) or (Path(), "")
        assert (run.absolute(), name) == (tmp_path / "run", "0001")


def test_a_changed_artefact_is_refused(copy: Path) -> None:
    """One flipped bit in the mesh or an edited plan is detected by the sha256 of the manifest."""
    run = open_run(copy)
    content = bytearray((copy / "reference.ply").read_bytes())
    content[len(content) // 2] ^= 1
    (copy / "reference.ply").write_bytes(content)
    with pytest.raises(FileError, match="changed or damaged"):
        run.mesh("reference.ply")
    (copy / "plan.json").write_text((copy / "plan.json").read_text().replace("0", "1", 1))
    with pytest.raises(FileError, match="changed or damaged"):
        run.plan  # noqa: B018


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_cut_file_without_a_sha256_is_damaged(copy: Path, share: float) -> None:
    """A killed run has no list of artefacts. A cut mesh, array or JSON file is still reported as damaged."""
    _manifest(copy, artefacts={}, status="running", stage="reach")
    run = open_run(copy)
    readers = {
        "reference.ply": lambda: run.mesh("reference.ply"),
        "motion.npz": lambda: run.motion,
        "plan.json": lambda: run.plan,
        "reach.npz": lambda: run.reach,
        "viewpoints.npz": lambda: run.candidates,
        "scene.resolved.json": lambda: run.scene,
        "cell.xml": lambda: run.cell_model(),
    }
    for name, read in readers.items():
        content = (copy / name).read_bytes()
        (copy / name).write_bytes(content[: int(share * len(content))])
        with pytest.raises(FileError, match=r"damaged[^\n]*$"):
            read()


def test_a_missing_file_of_a_failed_run_is_reported_with_the_stage(copy: Path) -> None:
    """The message for a missing file names the stage and the reason of the failure."""
    (copy / "motion.npz").unlink()
    with pytest.raises(FileError, match="although the run finished"):
        open_run(copy).motion  # noqa: B018
    _manifest(copy, status="failed", stage="reach", reason="none is reachable; move the part")
    with pytest.raises(FileError, match="failed in the stage 'reach': none is reachable; plan again"):
        open_run(copy).motion  # noqa: B018


def test_complete_scans_of_an_execution_are_read(copy: Path) -> None:
    """Cut scans, scans with NaN and scans without angles are reported; the others are returned in order."""
    run = open_run(copy)
    with pytest.raises(FileError, match="has no execution yet"):
        read_execution(run, "latest")
    scans = copy / "executions" / "0001" / "scans"
    scans.mkdir(parents=True)
    whole = {
        "number": 1,
        "q_commanded": np.zeros(6),
        "q_reported": np.full(6, 1e-3),
        "T_object_scanner": np.eye(4),
        "T_object_scanner_true": np.eye(4),
        "points": np.ones((3, 3)),
        "counts": np.array([3]),
    }
    for number in (1, 2, 3, 4):
        np.savez_compressed(scans / f"{number:04d}.npz", **whole | {"view": number})
    (scans / "0002.npz").write_bytes((scans / "0002.npz").read_bytes()[:200])
    np.savez_compressed(scans / "0003.npz", **whole | {"view": 3, "points": np.full((3, 3), np.nan)})
    np.savez_compressed(scans / "0005.npz", points=np.ones((1, 3)))
    assert run.execution_ids == ["0001"]
    read = read_execution(run, "latest")
    assert [scan.view for scan in read.scans] == [1, 4]
    assert read.motion is None
    assert [Path(sentence.split()[0]).name for sentence in read.unreadable] == ["0002.npz", "0003.npz", "0005.npz"]
    assert "NaN" in read.unreadable[1]
    with pytest.raises(FileError, match="has no execution 7; it has 0001"):
        read_execution(run, "7")


def test_only_simulated_points_have_a_true_pose_and_counts_of_rays(tmp_path: Path) -> None:
    """Scans of another source have no true pose and no counts. A scan without a source counts as simulated."""
    stored = {"number": 1, "view": 7, "q_commanded": np.zeros(6), "q_reported": np.zeros(6), "points": np.zeros((2, 3)),
              "T_object_scanner": np.eye(4), "T_object_scanner_true": np.eye(4)}  # fmt: skip
    np.savez(tmp_path / "0001.npz", **stored, source="bench")
    scan = read_scan(tmp_path / "0001.npz")
    assert scan.T_true is scan.counts is None
    np.savez(tmp_path / "0001.npz", **stored, counts=np.array([2, 1]))
    scan = read_scan(tmp_path / "0001.npz")
    assert scan.counts is not None
    assert scan.counts[:3] == (2, 1, 0)
    np.testing.assert_array_equal(scan.poses, np.eye(4)[None])
