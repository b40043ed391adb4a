"""How JAX runs under the tests: on the CPU, quick to compile, in 32 bits unless asked otherwise.

Promotion of types and ranks stays "standard" and "allow": the core mixes counts with scores and
broadcasts `[N, C]` with `[C]` as NumPy does in nearly every module; casts would hide the rules.
Solvers and the metrics in the graph are strict about ranks.
"""

import functools
import gc
import importlib.metadata
import os
import tempfile
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["HF_HUB_OFFLINE"] = "1"  # weights come from servers of the tests alone
# The older emitters of fused operations take half of the time to compile; JAX 0.11 has none.
if importlib.metadata.version("jax").startswith("0.10."):
    flags = os.environ.get("XLA_FLAGS", ""), "--xla_cpu_use_fusion_emitters=false"
    os.environ["XLA_FLAGS"] = " ".join(flags).strip()

import jax
import jaxtyping
import pytest
from hypothesis import settings
from jax._src.interpreters import mlir

from tests import shape_checks

shape_checks.switch_on()

from remind_jax.compiled import kept, programs  # noqa: E402  (checked as well)
from remind_jax.config import profiles  # noqa: E402
from remind_jax.session import growing_memory  # noqa: E402

# The tests ask what is decided, not how fast: a third of the time to compile, the same results.
jax.config.update("jax_disable_most_optimizations", True)
if not jax.config.values["jax_compilation_cache_dir"]:
    folder = Path(tempfile.gettempdir()) / "remind-jax-test-programs"
    jax.config.update("jax_compilation_cache_dir", str(folder))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
jax.config.update("jax_traceback_in_locations_limit", 0)  # nobody reads where an operation is from
# Thousands of programs of one operation each: half of the time to make one goes into its context.
if hasattr(mlir, "make_ir_context"):
    mlir.make_ir_context = functools.cache(mlir.make_ir_context)
# Nothing goes to the cache folder of who runs the tests; the workers of pytest-xdist, which inherit
# the environment, and later runs share what is compiled.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ[kept.VARIABLE] = os.path.join(jax.config.values["jax_compilation_cache_dir"], "kept")
os.environ[profiles.VARIABLE] = os.devnull  # nor does a profile of theirs change a test
MOST_MAPS = 32_000
# A trace makes millions of small objects that live until it ends.
gc.set_threshold(100_000, 50, 100)
# Drawn examples of a property; `make test-slow` draws ten times as many.
settings.register_profile("quick", max_examples=20, deadline=None)
settings.register_profile("thorough", max_examples=200, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


# Files whose tests run one large program: one worker compiles it.
TOGETHER = {
    "tests/session/test_memory_file.py": "tests/remind/test_tracker.py",
    "tests/remind/test_trace.py": "tests/remind/test_tracker.py",
    "tests/plus/test_joining.py": "tests/plus/test_archive.py",
    "tests/remind/test_outcome.py": "tests/remind/association",
}
TOGETHER |= {
    f"tests/remind/{name}.py": "tests/remind/association"
    for name in (
        *(f"association/test_{one}" for one in ("similarity", "switches")),
        *(f"undecided/test_{one}" for one in ("examples", "settlement")),
    )
}


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Each file to one worker, some of them to the same one."""
    from xdist.scheduler import LoadFileScheduling

    class ByProgram(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return TOGETHER.get(file, file)

    return ByProgram(config, log)


def pytest_collection_finish():
    """What was imported is never looked at again by the garbage collector."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def x64():
    """Runs a test in 64 bits.

    Set for the whole process: the context manager of JAX holds for one thread only, and the host
    solvers are called in another one.
    """
    before = jax.config.values["jax_enable_x64"]
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture
def unchecked_shapes():
    """For tests of what is said of arrays that are wrong."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def optimized():
    """Compiles as users do."""
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)


@pytest.fixture(autouse=True, scope="module")
def _let_programs_go():
    """Every compiled program holds hundreds of memory maps, of which Linux allows 65,530.

    Modules share what they compile until half of them are taken.
    """
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        programs.clear_programs()


@pytest.fixture(autouse=True)
def _look_ahead_only_when_asked(request, monkeypatch):
    """Capacities of tests are tight on purpose; the next ones are not worth compiling."""
    if "looks_ahead" not in request.fixturenames:
        monkeypatch.setattr(growing_memory.GrowingMemory, "_look_ahead", lambda *_: None)


@pytest.fixture
def looks_ahead():
    """Prepares larger capacities as users' trackers do."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """For tests of pages, which are marked by `tests.headless_browser.needs_browser`."""
    from tests.headless_browser import open_browser

    with open_browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser
