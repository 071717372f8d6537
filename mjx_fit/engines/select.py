"""Select an engine by name."""

import sys

import jax

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.control.policies import Policy
from mjx_fit.control.policy_file import require_policy
from mjx_fit.engines.interface import Engine
from mjx_fit.utils import granted_cpus
from mjx_fit.utils.errors import RequestError, shown

ENGINES = ("auto", "mjx", "native")


def resolve(name: str) -> str:
    """Resolve the name of an engine: ``auto`` is MJX on an accelerator and native on a CPU.

    Raises:
        RequestError: The engine does not exist.
    """
    if name not in ENGINES:
        raise RequestError(f"--engine: {shown(name)} is invalid: choose from {', '.join(ENGINES)}")
    if name != "auto":
        return name
    return "native" if jax.default_backend() == "cpu" else "mjx"


def make_engine(name: str = "auto", config: Config | None = None, policy: Policy | None = None) -> Engine:
    """Make an engine for the configuration's scene, with the CPUs that this process may use.

    Args:
        name: ``mjx``, ``native``, or ``auto``: MJX on an accelerator and native on a CPU.
        config: The configuration; None: the defaults.
        policy: Custom policy; None: the policy that each attempt names.

    Raises:
        RequestError: The engine does not exist, the policy cannot be used, or ``randomize`` draws clearances
            or scales that change a shape's gaps.

    Example:
        >>> import jax, mjx_fit as mf
        >>> engine = mf.make_engine("native")
        >>> rollouts = engine.run(mf.draw_attempts(jax.random.key(0), 4), actions=2)
        >>> rollouts.felt.length.tolist()
        [2, 2, 2, 2]
    """
    if policy is not None:
        require_policy(policy)
    # Imported here, because ``resolve`` needs neither engine.
    from mjx_fit.engines.mjx.engine import MjxEngine
    from mjx_fit.engines.native.engine import NativeEngine
    from mjx_fit.scene.variation import require_drawable

    config = config or Config()
    require_drawable(config)
    chosen = resolve(name)
    if chosen == "mjx":
        _say_if_slots_are_few(config.scene)
    return (MjxEngine if chosen == "mjx" else NativeEngine)(config, granted_cpus.cpus(), policy)


def _say_if_slots_are_few(scene: SceneConfig) -> None:
    """Print a note to stderr if MJX may have to drop contact points that the C engine keeps."""
    enough = SceneConfig().max_contacts
    if scene.max_contacts < enough:
        print(
            f"mjx: scene.max_contacts is {scene.max_contacts}: a pressed peg has up to {enough} contact "
            "points; only the deepest count, and torques differ from those of native",
            file=sys.stderr,
        )
