"""Files that would block or fill a node are refused, whoever names them."""

import os
import zipfile

import pytest
import ros_harness
from request_fuzzer import resident_kib
from simulation_interfaces.msg import Result
from tss_interfaces.srv import RestoreSnapshot, SaveSnapshot

#: Contents of scenario files by the reason why they are refused.
ABSURD = {
    "nests deeper than": "description: " + "[" * 100_000,
    "repeats parts by aliases to more than": "a: &a0 [x, x]\n"
    + "".join(f"b{i}: &a{i + 1} [*a{i}, *a{i}]\n" for i in range(30)),
    "is too large; allowed": "# " + "x" * 5_000_000,
    "it is not text": b"\xff\xfe\x00",
}


@pytest.fixture
def pipe(tmp_path):
    """The path of a pipe into which nobody writes."""
    path = tmp_path / "pipe.yaml"
    os.mkfifo(path)
    return str(path)


def test_a_node_does_not_wait_for_a_pipe(start, pipe):
    waiting = [
        start("sim_node", scenario=pipe),
        start("stability_node", scenario=pipe),
        start("sim_node", "--params-file", pipe),
    ]
    for process in waiting:
        assert process.wait(ros_harness.START_S) in (1, 2)
        assert "allowed: a" in process.stderr and pipe in process.stderr, process.stderr


def test_a_running_simulator_refuses_what_would_block_or_fill_it(start, client, pipe, tmp_path):
    process = start("sim_node", start_paused=True, service_folder=str(tmp_path))
    simulator = ros_harness.Simulator(*client)
    simulator.do(SaveSnapshot, file="good.npz")
    outcome = simulator.set(scenario=pipe)
    assert not outcome.successful and "is a FIFO; allowed: a regular file" in outcome.reason
    assert not simulator.set(scenario=str(tmp_path)).successful
    for reason, content in ABSURD.items():
        file = tmp_path / "absurd.yaml"
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        outcome = simulator.set(scenario=str(file))
        assert not outcome.successful and reason in outcome.reason, outcome.reason[:300]
        assert len(outcome.reason) < 500
    os.mkfifo(tmp_path / "pipe.npz")
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("huge.npy", "w", force_zip64=True) as entry,
    ):
        for _ in range(200):
            entry.write(bytes(1_000_000))
    with open(tmp_path / "large.npz", "wb") as large:
        large.truncate(200_000_000)
    before = resident_kib(process)
    for file, reason in (
        ("pipe.npz", "is a FIFO; allowed: a regular file"),
        ("bomb.npz", "it would unpack to 200000000 bytes; allowed here: "),
        ("large.npz", "cannot be read"),
    ):
        code, why = simulator.refused(RestoreSnapshot, file=file)
        assert code == Result.RESULT_OPERATION_FAILED and reason in why, why
    assert resident_kib(process) < before + 50_000
    simulator.do(RestoreSnapshot, file="good.npz")
    assert process.stop() == 0 and "Traceback" not in process.stderr
