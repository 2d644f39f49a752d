"""The commands that can be resumed, as small as they go, without their figures."""

import json
import os
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import patch

import coopmap_env.studies.benchmark.methods as benchmark
import coopmap_env.studies.benchmark.plan as benchmark_plan
import coopmap_env.studies.benchmark.report
import coopmap_env.studies.benchmark.tables
import coopmap_env.studies.commands.reproduce
import coopmap_env.studies.localization.report
import coopmap_env.studies.localization.study as localization
import coopmap_env.studies.section3.report
import coopmap_env.studies.section3.study as section3
from coopmap_env.cli import main
from coopmap_env.core.files import write_atomically

TRAINING = (
    "--max-scans 4 --n-candidates 6 --validation-episodes 2 --seed 3 --ppo.total-steps 192 "
    "--ppo.segment-steps 64 --ppo.n-envs 2 --ppo.rollout-steps 16 --ppo.batch-size 32 "
    "--ppo.n-epochs 2 --ppo.hidden 16 --ppo.image-features 8"
)


def run(arguments, out, patches=()):
    with ExitStack() as stack:
        for target, values in patches:
            stack.enter_context(patch.multiple(target, **values))
        main([*arguments.split(), "--out", out])


def write_tables(out, evaluations):
    """Scores by name, without times, instead of a report."""
    tables = {
        name: {key: column.tolist() for key, column in evaluation.table.items() if "_ms" not in key}
        for name, evaluation in evaluations.items()
    }
    write_atomically(Path(out) / "summary.json", json.dumps(tables))


def evaluate(out):
    run("evaluate --policies random,raster --episodes 3 --max-scans 2 --workers 2", out)


def record(out):
    run("record --policy random --episodes 3 --max-scans 2 --workers 2", out)


def compare(out):
    short = {"n_robots": 2, "max_scans": 2, "split": "test", "reward": "rating"}
    methods = tuple(
        benchmark.planner_method(name, benchmark.with_n_candidates(8))
        for name in ("rating_function", "coverage")
    )
    condition = benchmark.Condition("all policies", "planar", 2, short, methods)
    plan = benchmark_plan.BenchmarkPlan((condition,), ())

    def report(study, out):
        results = study.main[0].method_results
        write_tables(out, {result.method.label: result.runs[0] for result in results})

    run(
        "compare --quick",
        out,
        [
            (benchmark_plan, {"make_plan": lambda *_: plan}),
            (coopmap_env.studies.benchmark.report, {"write_benchmark_report": report}),
            (coopmap_env.studies.benchmark.tables, {"benchmark_text": str}),
        ],
    )


def study_localization(out):
    def report(study, out):
        write_tables(out, study.evaluations)

    run(
        "localization --quick",
        out,
        [
            (
                localization,
                {
                    "QUICK": localization.LocalizationSize(1, 1, 1),
                    "SEARCH_SCANS": 1,
                    "SCANS_EACH": 1,
                    "compare_pose_estimators": lambda *_: {},
                },
            ),
            (
                coopmap_env.studies.localization.report,
                {"write_localization_report": report, "localization_text": str},
            ),
        ],
    )


def reproduce(out):
    def report(study, out, field):
        write_tables(out, {**study.references, **study.searches, **study.house})

    size = section3.Section3Size(1, 1, (0.2,), 1, 1, clairvoyant=False)
    run(
        "reproduce --quick",
        out,
        [
            (
                section3,
                {
                    "QUICK": size,
                    "SEARCHES": (10,),
                    "SWEEP_SEARCHES": (10,),
                    "SCANS_EACH": 2,
                    "HOUSE_SCANS_EACH": 2,
                    "HOUSE_POLICIES": ("raster",),
                    "all_trends": lambda *_: {},
                    "record_snapshot": lambda *_, **__: None,
                    "compare_calibration": lambda *_: {},
                },
            ),
            (section3.killian, {"run_killian": lambda **_: None}),
            (
                coopmap_env.studies.section3.report,
                {"write_report": report, "text_table_1": str},
            ),
            (
                coopmap_env.studies.commands.reproduce,
                {"missing_extras": lambda extras: {"field": ["it is left out here"]}},
            ),
        ],
    )


def train(out):
    run(f"train {TRAINING}", out)


def train_with_sb3(out):
    run(f"train --engine sb3 {TRAINING}", out)


def train_with_rllib(out):
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    run(f"train --engine rllib {TRAINING}", out)


COMMANDS = {
    "evaluate": evaluate,
    "record": record,
    "compare": compare,
    "localization": study_localization,
    "reproduce": reproduce,
    "train": train,
    "train with sb3": train_with_sb3,
    "train with rllib": train_with_rllib,
}
