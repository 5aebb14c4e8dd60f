"""Tables of perception, files and clusters."""

from __future__ import annotations

from benchmarks.documents.measured import (
    NONE,
    Table,
    read,
)
from benchmarks.documents.perception_table import SOURCES, perception_rows
from fungrasp.core.formats import (
    image_file,
    json_file,
    mesh_file,
    mujoco_model,
    numpy_files,
    onnx_file,
    pickle_file,
    sandbox,
    toml_file,
    yaml_file,
)
from fungrasp.core.formats.file_bytes import DEEPEST, MOST_NODES
from fungrasp.core.formats.xml_file import DEEPEST_ELEMENT


def perception() -> Table:
    """What is found in captures of objects kept aside, against the targets."""
    return Table(("figure", "target", "measured"), perception_rows(read), SOURCES)


def hands_added() -> Table:
    """Hands of other makers: what became of their descriptions, and how many grasps they lift."""
    head = (
        "hand",
        "fingers",
        "joints, driven / all",
        "contact error, largest self-penetration [mm]",
        "success",
    )
    rows = []
    for row in read("hands-added").rows:
        if row["refused"]:
            rows.append((row["hand"], NONE, NONE, NONE, f"refused: {row['refused']}"))
            continue
        rows.append(
            (
                row["hand"],
                str(row["fingers"]),
                f"{row['driven']} / {row['joints']}",
                f"{row['contact_error_mm']:.1f}, {row['self_penetration_mm']:.1f}",
                f"{100 * row['lifted'] / row['grasps']:.0f} %",
            )
        )
    return Table(head, rows, ["hands-added"])


def limits() -> Table:
    """What is read of each format, from the constants that the readers use."""
    plain = f"{MOST_NODES / 1e6:g} million values, {DEEPEST} levels, integers of 64 bits"
    child = f"{sandbox.SECONDS:g} s and 1 s for each {sandbox.BYTES_PER_SECOND / 1e6:g} MB"
    child += f"; {sandbox.MEMORY / 1e9:g} GB"
    kept = f"{numpy_files.LARGEST >> 20} MB of arrays, {numpy_files.MOST_ARRAYS} arrays, "
    kept += f"{numpy_files.MOST_AXES} axes"
    rows = [
        ("NumPy (`.npz`, `.npy`)", _megabytes(numpy_files.LARGEST), f"{kept}; numbers, flags, text", NONE),
        ("JSON", _megabytes(json_file.LARGEST), plain, NONE),
        ("TOML", _megabytes(toml_file.LARGEST), plain, NONE),
        ("YAML", _megabytes(yaml_file.LARGEST), plain, NONE),
        (
            "pickle",
            _megabytes(pickle_file.LARGEST),
            f"{pickle_file.MOST_STEPS / 1e6:g} million steps; arrays",
            NONE,
        ),
        (
            f"images ({', '.join(image_file.FORMATS)})",
            _megabytes(image_file.LARGEST),
            f"{image_file.LARGEST_PIXELS / 1e6:g} million pixels",
            NONE,
        ),
        ("meshes", _megabytes(mesh_file.LARGEST), f"{mesh_file.MOST_FACES / 1e6:g} million faces", child),
        (
            "MJCF, URDF",
            _megabytes(mujoco_model.LARGEST),
            f"{DEEPEST_ELEMENT} levels, no entities, declared sizes up to {mujoco_model.LARGEST_SIZE:,}",
            child,
        ),
        (
            "ONNX",
            _megabytes(onnx_file.LARGEST),
            f"{onnx_file.MOST_MESSAGES:,} nodes, attributes, tensors; {len(onnx_file.OPERATORS)} operators",
            child,
        ),
    ]
    return Table(
        ("format", "largest file", "what it may hold", "processor time; memory to parse it"), rows, []
    )


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.3g} MB"


def fuzz() -> Table:
    """Damaged files by kind."""
    result = read("fuzz")
    rows = [
        (
            row["kind"],
            f"{row['cases']:,}",
            f"{row['taken']:,}",
            f"{row['refused']:,}",
            str(row["unclean"]),
            f"{row['slowest_s']:.1f}",
            f"{row['memory_mb']:.0f}",
        )
        for row in result.rows
    ]
    head = ("kind", "cases", "taken", "refused", "not clean", "slowest [s]", "largest memory [MB]")
    return Table(head, rows, ["fuzz"])


def kills() -> Table:
    """Long work that was killed and went on."""
    rows = [
        (f"`{row['what']}`", str(row["kills"]), str(row["finished"]), str(row["found"]))
        for row in read("kills").rows
    ]
    return Table(("work", "killed", "came to its end", "other result, or something left"), rows, ["kills"])


def cluster() -> Table:
    """A cluster, one machine of which was killed, beside one process."""
    head = (
        "",
        "processors",
        "time [s]",
        "processor time [s]",
        "at work",
        "work in a processor second",
        "same outcomes",
    )
    result, cells = read("cluster"), []
    header = result.header
    for row in result.rows:
        many = row["run"] == "cluster"
        cells.append(
            (
                f"{header['machines']} machines, one killed half way" if many else row["run"],
                f"{row['processors']:.2f}",
                f"{row['seconds']:.0f}",
                f"{row['processor_seconds']:.0f}",
                f"{row['at_work']:.1%}",
                f"{header['work_per_processor_second']:.1%}" if many else "100 %",
                f"{header['equal']:,} of {header['grasps']:,}" if many else NONE,
            )
        )
    return Table(head, cells, ["cluster"])
