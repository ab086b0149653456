"""What measures the program itself."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich.text import Text

from pipeline.answering.bench import Endurance, bench_source, run_endurance
from pipeline.corrections.review.bench import ReviewBenchConfig, bench_review
from pipeline.corrections.review.out_of_fold import EPOCHS, REVIEWED, DoubtConfig
from pipeline.evaluation.bench import bench_evaluation
from pipeline.evaluation.labels_bench import bench_labels
from pipeline.language.counted import counted
from pipeline.relations.features import CLI_FEATURES
from pipeline.system.errors import require
from pipeline.training.ablation import AblationConfig, compare_features
from pipeline.training.train import TrainConfig
from spatialviz.cli_models import Bench, BenchDetect, BenchEval, BenchLabel, BenchReview, BenchSrm
from spatialviz.options import FINE, NO, LabelledOptions
from spatialviz.printing import figure, print_rows, print_table, progress_bars, rate_bar, say, table_record


def run_bench(command: Bench) -> None:
    record = bench_source(command.source.open(command.dataset), repeat=command.repeat)
    command.write(record, print_bench)


def run_bench_label(command: BenchLabel) -> None:
    record = bench_labels(
        LabelledOptions().spec(command.dataset), views=command.views, repeat=command.repeat, workers=command.workers
    )
    command.write(record, print_label_bench)


def run_bench_eval(command: BenchEval) -> int:
    record = bench_evaluation(
        command.dataset,
        command.labels,
        recording=command.recording,
        workers=command.workers,
        singly=command.singly,
        pairs=command.pairs,
    )
    command.write(record, print_evaluation_bench)
    return FINE if not record["asked_singly"]["differ"] else NO


def run_bench_srm(command: BenchSrm) -> None:
    config = AblationConfig(
        rooms=command.rooms,
        views=command.views,
        pairs=command.pairs,
        features=tuple(CLI_FEATURES[name] for name in command.features),
        networks=command.networks,
        labels=command.labels,
        train=TrainConfig(batch=command.batch, epochs=command.epochs, seed=command.seed),
    )
    with progress_bars() as advance:
        table = compare_features(config, workers=command.workers, progress=advance)
    command.write(table_record(table), print_table, table)


def run_bench_review(command: BenchReview) -> None:
    config = ReviewBenchConfig(
        rooms=command.rooms,
        views=command.views,
        share=command.share,
        top=command.top,
        again=command.again,
        labels=command.labels,
        networks=command.networks,
        seeds=command.seeds,
        seed=command.seed,
        doubts=DoubtConfig(
            command.folds, command.passes, TrainConfig(vocabulary=REVIEWED, epochs=EPOCHS, batch=command.batch)
        ),
        train=TrainConfig(batch=command.batch),
    )
    with progress_bars() as advance:
        record = bench_review(config, workers=command.workers, progress=advance)
    command.write(record, print_review_bench)


def run_bench_detect(command: BenchDetect) -> None:
    require(command.count >= 1, "--count must be at least 1", got=command.count)
    source, frame_ids = command.source.open(command.dataset)
    with rate_bar("detecting", "frames") as advance:
        report = run_endurance(source, frame_ids, command.count, advance)
    command.write(asdict(report), print_endurance, report)


_MEANING = {
    "read": "labels and frames",
    "parse": "sentences",
    "opm": "recorded proposals and their masks",
    "lift": "up vector, depth edges, points",
    "srm": "relations of all pairs",
    "rank": "the best pair",
    "records": "what was right",
    "verdicts": "which module failed",
    "tables": "tables with intervals, of 50,000 records",
}


def print_evaluation_bench(record: dict[str, Any]) -> None:
    """Stages, one by one, the whole job, training, and what the goals would take."""
    say(
        f"{record['expressions']} expressions of {record['frames']} frames, K={record['k']}, {record['scorer']}; "
        "stages in processor time of one thread"
    )
    count = record["expressions"]
    print_rows(
        ("stage", ">seconds", ">ms/expression", ""),
        (
            (
                name,
                f"{seconds:.3f}",
                "" if name == "tables" else f"{seconds / count * 1000:.3f}",
                Text(_MEANING[name], "dim"),
            )
            for name, seconds in record["stages_s"].items()
        ),
    )
    alone = record["asked_singly"]
    say(
        f"{record['expressions_per_s']:.0f} expressions/s; asked one by one {alone['expressions_per_s']:.1f}: "
        f"{alone['ratio']:.1f} times as fast"
    )
    same = f"the same answer for {alone['same_answers']} of {alone['expressions']} asked both ways"
    say(same, style="red" if alone["differ"] else "")
    job = record["job"]
    memory = "unknown here" if job["peak_memory_mb"] is None else f"{job['peak_memory_mb']} MB"
    say(
        f"whole job: {job['seconds']} s with {job['workers']} workers, "
        f"peak memory {memory} in {job['processes']} processes"
    )
    training = record["training"]
    if "skipped" in training:
        say(f"training was not measured: {training['skipped']}", style="yellow")
    else:
        repeated = f", {training['of_labels']} repeated" if training["of_labels"] < training["pairs"] else ""
        say(
            f"training {training['features']} on {training['pairs']} pairs{repeated}, {training['epochs']} epochs: "
            f"{training['seconds']} s, {training['pairs_per_s']:,.0f} pairs/s"
        )
    say("extrapolated:")
    for name, seconds in record["extrapolated"].items():
        if name != "workers":
            count = int(name.split("_")[2])
            with_workers = f" with {record['extrapolated']['workers']} workers" if "expressions" in name else ""
            shown = "not known" if seconds is None else f"{seconds} s"
            say(f"  {count:,} {name.split('_')[3]}{with_workers}: {shown}")


def print_label_bench(record: dict[str, Any]) -> None:
    """Lifting beside the recipe, relations, and the whole job."""
    lifting = record["lifting"]
    say(
        f"{counted(record['views'], 'rendered view')}, {counted(record['objects'], 'object')}, "
        f"{record['width']}x{record['height']}; "
        "processor time of one thread"
    )
    keys = ("ms_per_frame", "face_error_cm", "face_error_p95_cm")
    print_rows(
        ("lifting and relations", ">ms/frame", ">face error cm", ">95 % of faces below cm"),
        ((name, *(figure(lifting[name].get(key), ".2f") for key in keys)) for name in ("ours", "open3d recipe")),
    )
    if "ratio" in lifting:
        say(f"ours is {lifting['ratio']:.1f} times as fast as {lifting['recipe']}")
    else:
        say(lifting["open3d recipe"]["skipped"], style="yellow")
    for name, rate in record["relations"]["pairs_per_s"].items():
        say(f"  {name:<34} {rate:>10,} pairs/s")
    job = record["job"]
    say(
        f"whole job: {job['frames']} frames with {job['objects_per_frame']} objects each in {job['seconds']} s "
        f"({job['workers']} workers, {job['frames_per_s']} frames/s), {job['candidates_per_frame']} candidate "
        f"expressions a frame; 1,500 such frames: {job['seconds_for_1500_frames']} s and the start"
    )


def print_review_bench(record: dict[str, Any]) -> None:
    """One line a seed, and the means."""
    say(
        f"{record['pairs']} pairs, labels {record['labels']}, {record['share']:.0%} of the cells turned; by confident "
        f"learning alone, the first {record['top']:.0%} looked at, then {record['again']:.0%} of the queue built anew"
    )
    columns = ("", "planted", "estimated", "found", "found in all", "F1 true", "planted", "mended", "in all", "F1 back")
    print_rows(
        (f">{name}" for name in (*columns, "in all", "seconds")),
        (
            (
                f"seed {number}",
                str(run["planted"]),
                f"{run['estimated']:.0f}",
                f"{run['found']:.1%}",
                f"{run['found_again']:.1%}",
                *(f"{run['f1'][k]:.4f}" for k in ("clean", "planted", "mended", "again")),
                *(figure(run["recovered"][k], ".1%") for k in ("mended", "again")),
                f"{run['seconds']:.1f}",
            )
            for number, run in enumerate(record["runs"])
        ),
    )
    mean = record["mean"]
    say(
        f"found {mean['found']:.1%}, in all {mean['found_again']:.1%}; of the lost F1 "
        f"{figure(mean['recovered'], '.1%')} is back{_between(mean['recovered_interval'])}, in all "
        f"{figure(mean['recovered_again'], '.1%')}{_between(mean['recovered_again_interval'])}"
    )
    say(record["caveat"], style="yellow")


def _between(interval: list[float] | None) -> str:
    return "" if interval is None else f" [{interval[0]:.1%}, {interval[1]:.1%}]"


def print_endurance(report: Endurance) -> None:
    """The rate and the memory of a run, in two lines."""
    say(
        f"{report.detector}: {report.pictures} pictures, {report.detections} detections, "
        f"{report.frames_per_second:.1f} frames/s"
    )
    if report.growth_mb is not None:
        low, high = min(report.resident_mb), max(report.resident_mb)
        say(f"memory {low:.0f} to {high:.0f} MB, from the second to the last quarter {report.growth_mb:+.1f} MB")


def print_bench(record: dict[str, Any]) -> None:
    """Milliseconds by stage and the ratios between them."""
    sizes = ", ".join(counted(record[f"{what}s"], what) for what in ("frame", "object"))
    say(f"{sizes}, {record['width']}x{record['height']}")
    for stage, ms in record["ms_per_frame"].items():
        say(f"  {stage:<22} {ms:8.2f} ms")
    for name, ratio in record["ratios"].items():
        say(f"  {name:<22} {ratio:8.2f}x")
