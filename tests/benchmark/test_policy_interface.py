"""How a policy is found from the name on a command line, and the named policies themselves."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from baselines.registry import BY_DRIVE, POLICIES, PREDICTIVE
from tests.benchmark.stub_policies import Constant
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.policies import load_policy
from tracked_env.benchmark.policy_interface import (
    PolicyContext,
    PolicyEntry,
    PolicyError,
    checked_policy,
    needs_truth,
)
from tracked_env.benchmark.runner import drive
from tracked_env.observation import SIZE
from tracked_env.physics.parameters import PARAMETER_INDEX, plant_parameters

CONTEXT = PolicyContext(control_period=0.05, lateral="constrained")


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Name of an importable module with the stub policies in it."""
    source = Path(__file__).with_name("stub_policies.py").read_text(encoding="utf-8")
    (tmp_path / "their_policies.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "their_policies", raising=False)
    return "their_policies"


def made(spec):
    return checked_policy(load_policy(spec, POLICIES), CONTEXT)


def test_a_registered_name_makes_a_fresh_policy_each_time():
    entry = load_policy("nominal", POLICIES)
    assert entry.name == "nominal"
    assert checked_policy(entry, CONTEXT) is not checked_policy(entry, CONTEXT)


@pytest.mark.parametrize("name", [n for n in BY_DRIVE["torque"] if n not in PREDICTIVE])
def test_named_policies_get_clock_and_lateral_model_of_the_environment(name):
    policy = made(name)
    controller = getattr(policy, "controller", policy)
    assert (controller.control_period, controller.lateral) == (0.05, "constrained")


def test_only_the_oracle_asks_for_the_truth():
    sliding = CONTEXT._replace(lateral="sliding")
    truthful = [name for name in BY_DRIVE["torque"] if needs_truth(POLICIES[name](sliding))]
    assert truthful == ["oracle", "mpc-oracle"]


def test_the_oracle_controls_with_the_parameters_it_is_told_and_nominal_with_its_own():
    truth = {name: np.full(3, value) for name, value in plant_parameters()._asdict().items()}
    truth["mass"] = np.array([1000.0, 1450.0, 2000.0])
    truth["x"] = np.zeros(3)  # the state is there too, and ignored
    nominal, oracle = made("nominal"), made("oracle")
    oracle.observe_truth(truth)
    observation = np.zeros((3, SIZE), dtype=np.float32)
    observation[:, 0] = 1.0
    told, own = oracle.predict(observation)[0], nominal.predict(observation)[0]
    used = oracle.controller.parameters[PARAMETER_INDEX["mass"]]
    assert used.tolist() == [1000.0, 1450.0, 2000.0]
    assert told[1] == pytest.approx(own[1], abs=1e-6)  # the filter starts where the sensors are
    assert told[0, 0] < own[0, 0] < told[2, 0]


def test_what_a_module_names_is_used_called_or_called_with_the_context(module):
    assert made(f"{module}:INSTANCE") is made(f"{module}:INSTANCE")
    policy = made(f"{module}:Constant")
    assert policy.action == (0.3, 0.3) and policy is not made(f"{module}:Constant")
    assert made(f"{module}:WithContext").context == CONTEXT


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("nominl", "Did you mean 'nominal'"),
        ("agents/ppo.zip", "not loaded by the harness.*module:function"),
        ("no_such_module:policy", "No module named 'no_such_module'.*current folder"),
        ("{module}:Missing", "no attribute 'Missing'"),
        ("{module}:NOTHING", "no `predict` and is no factory"),
        (":x", "policy ':x', when it was imported: ValueError"),
        ("..up:x", "policy '..up:x', when ..up was imported: TypeError"),
        ("{module}:", "has no attribute ''"),
    ],
)
def test_what_is_no_policy_is_refused_with_what_would_be_one(module, spec, message):
    with pytest.raises(ValueError, match=message):
        load_policy(spec.format(module=module), POLICIES)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero .*broken.py, line 1"),
        ("import sys; sys.exit(0)", r"it called sys.exit\(0\)"),
        ("def (", "SyntaxError: invalid syntax .*line 1"),
        (
            "class Odd:\n def __getattr__(self, name): raise KeyError(name)\npolicy = Odd()",
            "KeyError",
        ),
    ],
)
def test_a_module_that_cannot_be_imported_is_named_in_one_line(
    tmp_path, monkeypatch, source, message
):
    (tmp_path / "broken.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "broken", raising=False)
    with pytest.raises(PolicyError, match=f"policy 'broken:policy'.*{message}") as caught:
        load_policy("broken:policy", POLICIES)
    assert "\n" not in str(caught.value)
    monkeypatch.delitem(sys.modules, "broken", raising=False)


def raising(error):
    def make(context):
        raise error

    return make


class Deaf:
    needs_truth = True

    def predict(self): ...


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("json:dumps", "TypeError: dumps.. missing 1 required positional argument: 'obj'"),
        ("builtins:dict", "which has no method `predict`"),
        ("os:getcwd", "which has no method `predict`"),
        ("sys:exit", r"it called sys.exit\(None\)"),
        ("math:sin", "TypeError"),
        (raising(ValueError("no\nsuch file")), r"ValueError: no such file \(.*line"),
        (raising(RuntimeError()), r"RuntimeError \(.*line"),
        (raising(SystemExit(0)), r"it called sys.exit\(0\).*\(.*line"),
        (lambda context: 3, "no method `predict`"),
        (lambda context: Deaf(), "no `observe_truth`"),
    ],
)
def test_a_callable_that_makes_no_policy_is_named_in_one_line(policy, message):
    entry = PolicyEntry("bad", policy, "1") if callable(policy) else load_policy(policy, POLICIES)
    said = f"^policy '{entry.name}', when it was made: .*{message}"
    with pytest.raises(PolicyError, match=said) as caught:
        checked_policy(entry, CONTEXT)
    assert "\n" not in str(caught.value)
    with pytest.raises(KeyboardInterrupt):  # an interruption is no error of the policy
        checked_policy(PolicyEntry("slow", raising(KeyboardInterrupt), "1"), CONTEXT)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of others, importable as `their_package`."""
    folder = tmp_path / "their_package"
    (folder / "deep").mkdir(parents=True)
    for name in ("__init__.py", "deep/__init__.py", "deep/law.py", "plots.py"):
        (folder / name).write_text("A = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def fingerprint():
    return source_fingerprint("their_package.deep", without={"plots.py", "pictures/"})


@pytest.mark.parametrize("name", ["__init__.py", "deep/__init__.py", "deep/law.py"])
def test_the_fingerprint_changes_with_every_file_of_the_package(package, name):
    first = fingerprint()
    (package / name).write_text("A = 2\n")
    assert fingerprint() != first


def test_the_fingerprint_does_not_change_with_what_is_left_out_by_its_path(package):
    first = fingerprint()
    (package / "plots.py").write_text("A = 2\n")
    (package / "pictures").mkdir()
    (package / "pictures" / "law.py").write_text("A = 2\n")
    assert fingerprint() == first
    (package / "deep" / "plots.py").write_text("A = 2\n")  # the same name, another path
    assert fingerprint() != first


def test_the_fingerprint_tells_the_same_bytes_in_other_files_apart(package):
    first_file, second_file = package / "deep" / "a.py", package / "deep" / "b.py"
    found = []
    for one, two in (("#1", "#2deep/b.py#3"), ("#1deep/b.py#2", "#3")):  # the end of one slides
        first_file.write_text(one)
        second_file.write_text(two)
        found.append(fingerprint())
    second_file.rename(package / "b.py")
    assert len({*found, fingerprint()}) == 3


class SlowAtFirst(Constant):
    """Needs a tenth of a second for its first action, as a policy that compiles in it."""

    def predict(self, *args, **kwargs):
        if not self.calls:
            time.sleep(0.1)
        return super().predict(*args, **kwargs)


@pytest.mark.parametrize(("rate", "least", "most"), [(50.0, 0.0, 0.02), (10.0, 0.1, 1.0)])
def test_the_first_call_of_predict_is_timed_only_where_it_is_the_only_one(rate, least, most):
    config = BenchmarkConfig(episodes=2, duration=0.1, control_rate=rate)
    env = config.environment("nominal", 2, truth=False)
    policy = SlowAtFirst()
    _, seconds = drive(policy, env, [0, 1], lambda: None)
    assert len(policy.calls) == (1 if rate == 10.0 else 5)
    assert least < seconds < most
