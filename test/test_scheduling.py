# SPDX-License-Identifier: BSD-3-Clause
"""Files that share the suite run in one process, and a process that crashes holds nobody up."""

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("xdist")
SHARING = ["test/test_examples.py::test_a", "test/test_examples.py::test_b",
           "test/test_stage_faults.py::test_c"]
ALONE = ["test/test_kernels.py::test_d", "src/piezo_models/test/test_x.py::test_e"]


class Process:
    """Run tests as xdist's processes do: each but the last one, unless it is told to end."""

    def __init__(self, name):
        self.gateway = SimpleNamespace(id=name)
        self.waiting, self.shutting_down = [], False

    def send_runtest_some(self, indices):
        self.waiting += indices

    def shutdown(self):
        self.shutting_down = True

    def runs(self):
        """Take the next test that it runs now; None where it waits."""
        ready = len(self.waiting) > 1 or self.waiting and self.shutting_down
        return self.waiting.pop(0) if ready else None


@pytest.fixture
def scheduling(request):
    """What distributes tests over two processes that have collected them, and these."""
    config = SimpleNamespace(getvalue={"tx": ["popen", "popen"], "maxprocesses": None}.get,
                             option=SimpleNamespace(loadscopereorder=True))
    scheduling = request.config.pluginmanager.hook.pytest_xdist_make_scheduler(
        config=config, log=None)
    # Without the plugin, whose hook takes the first result, there is a list of them.
    return scheduling[0] if isinstance(scheduling, list) else scheduling


def join(scheduling, process, tests):
    scheduling.add_node(process)
    scheduling.add_node_collection(process, tests)
    return process


def run_all(scheduling, processes, tests):
    """Run until every process waits; return the tests of each."""
    ran = {process: [] for process in processes}
    while moved := [(process, index) for process in processes
                    if (index := process.runs()) is not None]:
        for process, index in moved:
            ran[process].append(tests[index])
            scheduling.mark_test_complete(process, index)
    return list(ran.values())


def test_listed_files_run_in_one_process(scheduling):
    tests = SHARING + ALONE
    processes = [join(scheduling, Process(name), tests) for name in ("one", "other")]
    scheduling.schedule()
    one, other = run_all(scheduling, processes, tests)
    assert sorted(one + other) == sorted(tests)
    assert set(SHARING) <= set(one) or set(SHARING) <= set(other)
    assert all(process.shutting_down for process in processes)


def test_process_that_takes_over_a_single_test_from_one_that_crashed_runs_it(scheduling):
    processes = [join(scheduling, Process(name), ALONE) for name in ("one", "other")]
    scheduling.schedule()
    crashed, other = processes
    assert scheduling.remove_node(crashed) == ALONE[0]
    successor = join(scheduling, Process("successor"), ALONE)
    scheduling.schedule()
    assert run_all(scheduling, [other, successor], ALONE) == [[ALONE[1]], [ALONE[0]]]
    assert scheduling.tests_finished


def item(nodeid):
    return SimpleNamespace(nodeid=nodeid, path=Path(nodeid.partition("::")[0]),
                           get_closest_marker=lambda name: None)


def test_files_that_share_nodes_come_last_and_all_others_stay_in_their_order(request):
    listed = request.config.pluginmanager.get_plugin(str(request.config.rootpath / "conftest.py"))
    items = [item(nodeid) for nodeid in (SHARING[0], ALONE[1], SHARING[2], ALONE[0])]
    listed.pytest_collection_modifyitems(request.config, items)
    assert [each.nodeid for each in items] == [ALONE[1], ALONE[0], SHARING[0], SHARING[2]]


def test_every_file_that_shares_nodes_or_what_they_identified_is_listed(request):
    listed = request.config.pluginmanager.get_plugin(str(request.config.rootpath / "conftest.py"))
    using = {fixture: {item.path.stem for item in request.session.items
                       if fixture in item.fixturenames} for fixture in listed.SHARED}
    assert using["identification"] <= listed.SHARED["identification"], "identified once more"
    assert using["whole_suite"] <= set().union(*listed.SHARED.values()), "started once more"
