"""From a scene file to its plan."""

from __future__ import annotations

from roemetry.config.scene import Scene
from roemetry.errors import PluginError
from roemetry.records import Plan
from roemetry.stages.registry import Registry, discover


def plan_of(scene: Scene, *, simulate: bool, registry: Registry | None = None) -> Plan:
    """Plan the rig that a scene describes.

    Parameters
    ----------
    scene
        What describes the rig; the planner is the one that comes with its simulator, under the same name.
    simulate
        Whether short simulations shall stand beside the prediction.
    registry
        What is installed.

    Raises
    ------
    PluginError
        The simulator's plugin has no planner, or one that reads another kind of scene.
    StageError
        The rig cannot measure a height, with the reason.
    """
    registry = registry or discover()
    chosen = scene.simulator
    name = f"{chosen.registered.provider.name}/{chosen.registered.entry.name}"
    found = registry.find("planner", name)
    stage = registry.load(found)
    if not isinstance(chosen.options, stage.Options):
        raise PluginError(f"the planner `{name}` does not read the scenes of the simulator of this name")
    plan: Plan = stage(chosen.options).plan(simulate=simulate)
    return plan
