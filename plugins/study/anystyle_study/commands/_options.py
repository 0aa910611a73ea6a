"""Plans from configurations, and tests with their options, for the study commands."""

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from anystyle.errors import UserError, unknown
from anystyle.io.documents import read_yaml
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import explain
from anystyle.registry.packages import presets
from anystyle_study.contract import StudyTest
from anystyle_study.protocol import Plan, plan_from


def read_plan(overrides: Sequence[str]) -> Plan:
    """The plan that ``study=NAME`` or ``study=FILE`` names (default: ``paper``), changed by ``key=value`` words."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    names = [word for word in overrides if word.startswith("study=")]
    config = names[-1].removeprefix("study=") if names else "paper"
    overrides = [word for word in overrides if word not in names]
    file = Path(config)
    if file.suffix not in (".yaml", ".yml"):
        known = presets("study")
        if config not in known:
            raise UserError(unknown("study configuration", config, known))
        file = known[config]
    options: dict[str, Any] = read_yaml(file, dict[str, Any], what="configuration of 'option: value' lines")
    try:
        merged = OmegaConf.merge(options, OmegaConf.from_dotlist(overrides))
        values: Any = OmegaConf.to_container(merged, resolve=False)
    except (OmegaConfBaseException, YAMLError) as error:
        raise UserError(f"{' '.join(overrides)}: {explain(error)}") from None
    return plan_from(values)


def build_tests(names: Sequence[str], overrides: Sequence[str], common: Mapping[str, Any]) -> dict[str, StudyTest]:
    """Build the named tests, all if none is named; ``common`` options are for every test that has them."""
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
    tests: dict[str, StudyTest] = {}
    for name in chosen:
        plugin = catalog().find("study_test", name)
        known = inspect.signature(plugin.load()).parameters
        shared = {option: value for option, value in common.items() if option in known}
        tests[name] = build(StudyTest, {"_target_": plugin.path, **shared, **options[name]})
    return tests
