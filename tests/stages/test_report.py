import json

from tests.stages.running import run_script


def test_it_writes_the_report_and_prints_the_table_and_where_it_lies(tmp_path):
    metrics = tmp_path / "metrics" / "studio"
    metrics.mkdir(parents=True)
    for method, psnr in (("oracle", 28.0), ("agnostic", 24.0), ("paper", 25.0)):
        content = {"scene": "studio", "method": method, "image": {"psnr": psnr}}
        (metrics / f"{method}.json").write_text(json.dumps(content))
    names = ("oracle", "agnostic", "paper")
    like = "scene: studio, observations: sharp, avatar: plain"
    runs = [f"  studio-{name}: {{{like}, method: {name}}}\n" for name in names]
    text = f"seed: 0\nanimations: {{}}\nexports: {{}}\nwithout_pictures: []\nruns:\n{''.join(runs)}"
    (tmp_path / "params.yaml").write_text(text)
    files = {
        "metrics": "metrics", "pictures": "evaluate", "animations": "animate", "exports": "export",
        "out": "reports", "params_file": "params.yaml",
    }  # fmt: skip
    done = run_script("report", **{key: tmp_path / file for key, file in files.items()})
    assert done.returncode == 0, done.stderr
    assert "25.00 *" in done.stderr
    assert f"The report: {tmp_path}/reports/index.html" in done.stderr
    summary = json.loads((tmp_path / "reports/summary.json").read_text())
    assert summary["methods"]["paper"]["recovery"]["psnr"] == 0.25
    assert "</html>" in (tmp_path / "reports/index.html").read_text()
