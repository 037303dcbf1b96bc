import json
import shutil

from ruamel.yaml import YAML

from deblur_avatar.config.proof import Cell, cells_of
from tests.evaluation.test_proof_grid import PSNR
from tests.proof_results import PLAN, small_plan, write_cell, write_pictures
from tests.stages.running import run_script


def test_it_writes_the_page_and_prints_the_grid_and_where_it_lies(tmp_path):
    for cell in cells_of(small_plan(), ["grid"]).values():
        write_cell(tmp_path / "metrics", cell, PSNR[cell.avatar, cell.motion])
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump({"seed": 0, "proof": PLAN}, file)
    done = run_script(
        "proof", metrics=tmp_path / "metrics", strips=tmp_path / "reports/strips",
        out=tmp_path / "reports", params_file=tmp_path / "params.yaml",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "16.00 *" in done.stderr
    assert f"The proof: {tmp_path}/reports/index.html" in done.stderr
    summary = json.loads((tmp_path / "reports/summary.json").read_text())
    paper = summary["scenes"]["leaping"]["grid"]["networks"]["paper"]
    assert paper["recovery"]["psnr_seen"] == 0.25
    assert paper["psnr_seen"] == {"mean": 16.0, "std": None}
    assert "</html>" in (tmp_path / "reports/index.html").read_text()


def test_pictures_that_lie_here_are_kept_beside_the_page(tmp_path):
    """The whole way: what `evaluate` left is on the page when its files are gone."""
    cell = Cell("leaping", "plain", "clip", "x1", 0)
    write_cell(tmp_path / "metrics", cell, 18.0)
    write_pictures(tmp_path / "data", cell)
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump({"seed": 0, "proof": PLAN}, file)
    given = {"metrics": tmp_path / "metrics", "params_file": tmp_path / "params.yaml"}
    strips = tmp_path / "reports/strips"
    done = run_script("proof_strips", pictures=tmp_path / "data", out=strips, **given)
    assert done.returncode == 0, done.stderr
    assert "Pictures kept: leaping, plain: clip" in done.stderr
    shutil.rmtree(tmp_path / "data")
    run_script("proof_strips", pictures=tmp_path / "data", out=strips, **given)
    run_script("proof", strips=strips, out=tmp_path / "reports", **given)
    page = (tmp_path / "reports/index.html").read_text()
    assert 'src="strips/leaping/plain/0-clip.jpg"' in page
