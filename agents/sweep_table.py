"""The one table at the end of a sweep: every agent, with all its seeds, on every set."""

from pathlib import Path
from typing import Any

from agents.sweep_file import Sweep
from baselines.learned.agent_archive import read_recipe
from tracked_env.benchmark import BenchmarkConfig, Store, check, default_sets, summarise
from tracked_env.benchmark.chunks import pending
from tracked_env.benchmark.executors import Executor
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.policy_lookup import load_policies
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.registered_policies import by_name, open_archive, registered_policies
from tracked_env.benchmark.report import marked, write
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.text_tables import aligned, markdown_rows

TABLE = "table.md"


def archives_of(sweep: Sweep) -> dict[str, list[Path]]:
    """The trained agents of a sweep, those that are there."""
    paths = {
        name: [options.folder / "agent.zip" for options in trainings]
        for name, trainings in sweep.trainings.items()
    }
    found = {name: [path for path in of if path.exists()] for name, of in paths.items()}
    return {name: of for name, of in found.items() if of}


def compared(sweep: Sweep, executor: Executor | None) -> str:
    """Evaluate the agents of a sweep; returns the table, which lies in OUTPUT/table.md, too.

    Raises ValueError and PolicyError.
    """
    first = next(iter(sweep.trainings.values()))[0]
    config = BenchmarkConfig(
        sets=sweep.sets or default_sets(first.env), episodes=sweep.episodes, lateral=first.lateral
    )
    registry, shipped = by_name(registered_policies(), config.env)
    trained = archives_of(sweep)
    agents = {**shipped, **trained}
    entries = load_policies([*sweep.compare, *trained], registry, agents, open_archive)
    store = Store(sweep.output / "evaluation", config.identity())
    workers = 1 if executor is None else executor.workers
    tasks = list(pending(config, entries, store, workers))
    total = sum(len(task.episodes) * config.max_steps(task.uncertainty_set) for task in tasks)
    with progress_bar(total) as progress:
        records = run(config, entries, store, progress, executor)
    rows = rows_of(records)
    summary = summarise(records, rows)
    write(store.folder, {**store.header, "benchmark": check(config)._asdict()}, records, summary)
    cells = table(rows, trained)
    note = (
        "IQM of the tracking RMSE [m] with 95 % intervals over seeds and episodes; held out: mean "
        "of the best\nRMSE [m] of each training on its held-out episodes. * fewer than 5 seeds"
    )
    text = f"{markdown_rows(cells, 1)}\n\n{note}\n\n{check(config).message}\n"
    write_atomically(sweep.output / TABLE, text.encode())
    return f"{aligned(cells, 1)}\n\n{note}"


def table(rows: dict[str, Row], trained: dict[str, list[Path]]) -> list[list[str]]:
    """Rows of cells, the header first: agents, and the IQM of the RMSE on each set and on all."""
    cells = [["agent", "seeds", "steps", "held out", *rows]]
    last = list(rows.values())[-1]
    for name in last.seeds:
        recipes: list[dict[str, Any]] = [read_recipe(path) or {} for path in trained.get(name, ())]
        best = [recipe["held_out_rmse"] for recipe in recipes if recipe.get("held_out_rmse")]
        steps = max((recipe["config"]["steps"] for recipe in recipes), default=0)
        cells.append(
            [marked(name, len(recipes)), f"{len(recipes) or '-'}", f"{steps:,}" if steps else "-",
             f"{sum(best) / len(best):.3f}" if best else "-",
             *(_between(row.summary(name).rmse_iqm) for row in rows.values())]
        )  # fmt: skip
    return cells


def _between(estimate: Estimate) -> str:
    return f"{estimate.value:.3f} [{estimate.low:.3f}, {estimate.high:.3f}]"
