"""What the study commands share: plans from configurations, and the tests to run."""

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from anystyle import paths
from anystyle.documents import read_yaml
from anystyle.errors import UserError, unknown
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import explain
from anystyle.study.contract import StudyTest
from anystyle.study.protocol import Plan, plan_from


def read_plan(overrides: Sequence[str]) -> Plan:
    """A plan from ``conf/study/paper.yaml``, or what ``study=NAME`` or ``study=FILE`` names, with ``key=value`` on top.

    Raises:
        UserError: There is no such configuration, or it is none.
        ValueError: An option is unknown or wrong.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    names = [word for word in overrides if word.startswith("study=")]
    config = names[-1].removeprefix("study=") if names else "paper"
    overrides = [word for word in overrides if word not in names]
    file = Path(config)
    if file.suffix not in (".yaml", ".yml"):
        file = paths.CONF / "study" / f"{config}.yaml"
        if not file.is_file():
            known = [path.stem for path in sorted(file.parent.glob("*.yaml"))]
            raise UserError(unknown("study configuration", config, known))
    options: dict[str, Any] = read_yaml(file, dict[str, Any], what="configuration of 'option: value' lines")
    try:
        merged = OmegaConf.merge(options, OmegaConf.from_dotlist(overrides))
        values: Any = OmegaConf.to_container(merged, resolve=False)
    except (OmegaConfBaseException, YAMLError) as error:
        raise UserError(f"{' '.join(overrides)}: {explain(error)}") from None
    return plan_from(values)


def build_tests(
    names: Sequence[str], overrides: Sequence[str], common: Mapping[str, Any] | None = None
) -> dict[str, StudyTest]:
    """The named tests of the catalog, all if none is named, with options given as ``TEST.OPTION=VALUE``.

    Options in ``common`` are for every test that has them.

    Raises:
        UserError: An override names a test that is not run.
        ValueError: A test or an option is unknown, or a value is wrong.
    """
    from omegaconf import OmegaConf

    chosen = list(dict.fromkeys(names)) or catalog().names("study_test")
    options: dict[str, dict[str, Any]] = {name: {} for name in chosen}
    for word in overrides:
        key, equals, value = word.partition("=")
        test, dot, option = key.removeprefix("study_test.").partition(".")
        if not (equals and dot and option):
            raise UserError(f"{word!r} sets no option; expected TEST.OPTION=VALUE, such as wilcoxon.zero_method=pratt")
        if test not in options:
            raise UserError(unknown("test that is run", test, options))
        options[test][option] = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={value}"]))["value"]  # type: ignore[index]
    plugins = {name: catalog().find("study_test", name) for name in chosen}
    tests: dict[str, StudyTest] = {}
    for name, plugin in plugins.items():
        known = inspect.signature(plugin.load()).parameters
        shared = {option: value for option, value in (common or {}).items() if option in known}
        tests[name] = build(StudyTest, {"_target_": plugin.path, **shared, **options[name]})
    return tests
