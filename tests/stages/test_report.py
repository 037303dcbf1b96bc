import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_it_writes_the_report_and_prints_the_table_and_where_it_lies(tmp_path):
    metrics = tmp_path / "metrics" / "studio"
    metrics.mkdir(parents=True)
    for method, psnr in (("oracle", 28.0), ("blind", 24.0), ("paper", 25.0)):
        content = {"scene": "studio", "method": method, "image": {"psnr": psnr}}
        (metrics / f"{method}.json").write_text(json.dumps(content))
    (tmp_path / "params.yaml").write_text("seed: 0\n")
    command = [
        sys.executable, str(ROOT / "stages/report.py"), "--metrics", str(tmp_path / "metrics"),
        "--pictures", str(tmp_path / "evaluate"), "--animations", str(tmp_path / "animate"),
        "--out", str(tmp_path / "reports"), "--params-file", str(tmp_path / "params.yaml"),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "25.00 *" in done.stderr
    assert f"The report: {tmp_path}/reports/index.html" in done.stderr
    summary = json.loads((tmp_path / "reports/summary.json").read_text())
    assert summary["methods"]["paper"]["recovery"]["psnr"] == 0.25
    assert "</html>" in (tmp_path / "reports/index.html").read_text()
