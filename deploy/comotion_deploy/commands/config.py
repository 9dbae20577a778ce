"""``comotion config``: the fusion parameters in effect."""

import json

import typer

from .. import options

EPILOG = """
Examples:

  comotion config --set sigma_switch=0.01 --set v_move=null

  comotion config --json

  comotion config > my.toml   # then: comotion serve --config my.toml
"""


def config(
    ctx: typer.Context,
    method: options.Method = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
) -> None:
    """Print the fusion parameters in effect, as TOML that --config reads (or JSON)."""
    from comotion import FusionConfig

    values = options.fusion_config(ctx, method, assignments).model_dump(mode="json")
    if json_:
        print(json.dumps(values, indent=2))
        return
    print("[fusion]")
    for name, field in FusionConfig.model_fields.items():
        print(f"# {field.description}")
        # JSON's strings, numbers and booleans are TOML's; only null is missing there.
        print(f"{name} = {json.dumps('null' if values[name] is None else values[name])}")
