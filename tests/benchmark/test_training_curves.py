"""What a training has left beside its archives."""

from pathlib import Path

from tracked_env.benchmark import training_curves as tc


def test_learning_curves_are_read_where_there_are_any(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("good", "none", "other", "empty")]
    for folder in folders:
        folder.mkdir()
    (folders[0] / "curve.csv").write_text("steps,seconds,held_out_rmse\n10,1,nan\n20,2,0.5\n")
    (folders[2] / "curve.csv").write_text("a,b\n1,2\n")
    (folders[3] / "curve.csv").write_text("steps,held_out_rmse\n10,nan\n")
    assert tc.read_curves({"x": folders, "y": folders[1:]}) == {"x": [[(20.0, 0.5)]]}


def test_the_cost_of_training_is_that_of_the_last_row_a_mean_over_seeds(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b", "none", "other")]
    for folder in folders:
        folder.mkdir()
    (folders[0] / "curve.csv").write_text("steps,cpu_seconds\n10,1\n1000000,100\n")
    (folders[1] / "curve.csv").write_text("steps,cpu_seconds\n3000000,200\n")
    (folders[3] / "curve.csv").write_text("steps,held_out_rmse\n20,0.5\n")
    assert tc.read_costs({"x": folders, "y": folders[2:]}) == {"x": tc.TrainingCost(2e6, 150.0)}
    assert str(tc.TrainingCost(2e6, 150.0)) == "2 M steps, 150 s"
