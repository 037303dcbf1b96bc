"""A sweep on a Ray cluster of two machines, one of which goes away half way.

Both are raylets of this machine, which share its folder.
"""

import os
import sys

import pytest

from deblur_avatar.sweep.costs import Costs
from deblur_avatar.sweep.scheduler import work_off
from deblur_avatar.sweep.stages import Pipelines
from tests.sweep.small_sweep import ROOT, begun, copied, results, results_of_root, tell

pytest.importorskip("ray", reason="Ray is not installed: pip install 'deblur-avatar[cluster]'")
cluster_utils = pytest.importorskip("ray.cluster_utils")
MACHINE = {"num_cpus": 1, "include_dashboard": False}


def test_a_machine_that_goes_away_costs_its_task_alone(made, serial, tmp_path, monkeypatch):
    from deblur_avatar.sweep.ray_engine import RayEngine

    project = copied(made, tmp_path / "swept")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(project)
    pipelines = Pipelines(project, ["dvc.yaml"])
    pipelines.run_always_changed()
    tasks = pipelines.tasks(Costs(project))
    before = pipelines.locks()
    tell(project, "warm-root_a", "wait")
    tell(project, "warm-root_b", "wait")
    left = []
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args=MACHINE)
    other = cluster.add_node(**MACHINE)

    def watch(progress, ended):
        """Once both machines are at work, one goes away; nothing ends before that is known.

        A worker outlives its machine by a moment, and what ends in that moment is not lost.
        """
        if not left and begun(project, "root_a") and begun(project, "root_b"):
            left.append(other)
            cluster.remove_node(other, allow_graceful=False)
        if progress.lost:
            tell(project, "warm-root_a", "")
            tell(project, "warm-root_b", "")

    try:
        engine = RayEngine(project, cluster.address, os.environ)
        progress = work_off(tasks, engine, watch, retries=2)
    finally:
        cluster.shutdown()
    pipelines.put_in_order(before)
    assert progress.failed == {}
    assert len(progress.done) == 9
    assert sum(progress.lost.values()) == 1
    assert results(project) == results_of_root(serial)


def test_what_a_raylet_says_goes_to_standard_error(tmp_path, monkeypatch, capsys):
    from ray._private.worker import print_to_stdstream

    from deblur_avatar.sweep import ray_engine

    monkeypatch.setattr(ray_engine.ray, "init", lambda **options: None)
    monkeypatch.setattr(ray_engine.ray, "shutdown", lambda: None)
    engine = ray_engine.RayEngine(tmp_path, None, {})
    said = {"lines": ["the node is marked dead"], "pid": "raylet", "is_err": False}
    print_to_stdstream(said, ignore_prefix=False)
    engine.stop()
    sys.stdout.write("done\n")
    out, err = capsys.readouterr()
    assert out == "done\n"
    assert "the node is marked dead" in err
