"""A run: label a dataset, answer every sentence of the labels with another detector, and read what came of it."""

import spatialviz as sp


def main() -> None:
    labels = sp.label("demo", "run_labels", limit=4)
    print(labels)
    run = sp.evaluate("demo", labels, "run", detector="simulated", limit=100, plots=False, name="simulated")
    print(run)
    for verdict, count in run.verdicts.items():
        print(f"{verdict:12} {count}")
    for row in run.tables["grounding"]:
        if row["row"] == "simulated":
            value, low, high = (row[f"set-valued{end}"] for end in ("", " low", " high"))
            print(f"accuracy, set-valued: {value:.3f} [{low:.3f}, {high:.3f}]")
    # Records are an Arrow table: one row an expression, every stage's outcome in it.
    wrong = [row for row in run.records.to_pylist() if row["verdict"] == "OPM-TARGET"]
    for row in wrong[:3]:
        print(f"{row['frame']}: {row['text']}")
    # run = sp.open_run("run") opens it again; sp.show(run) lists its failures in the page.


if __name__ == "__main__":
    main()
