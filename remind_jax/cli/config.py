"""`remind config`: prints, describes, compares, checks and imports configurations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg, subcommand

from remind_jax.backbone.registry import DEFAULT_BACKBONE, check_name
from remind_jax.cli.flags import Assignments, BackboneName, TrackerName, flags, load_config_with
from remind_jax.errors import ConfigError
from remind_jax.files import refuse_file, writing
from remind_jax.printing.terminal import print_lines

if TYPE_CHECKING:
    from remind_jax.config import Config


@flags
class List:
    """Print the shipped configurations, and what each of them is."""

    def execute(self) -> None:
        """Prints one configuration per line."""
        from remind_jax.config import describe_config, list_configs

        names = list_configs()
        width = max(map(len, names))
        for name in names:
            print(f"{name:<{width}}  {describe_config(name)}")


@flags
class Show:
    """Print every value that runs with a configuration, as YAML for 'run --config'."""

    name: Annotated[Positional[str], arg(metavar="[CONFIG]")] = "default"  # name, or YAML file
    backbone: BackboneName = DEFAULT_BACKBONE  # some thresholds fit it
    changes: Assignments = ()

    def execute(self) -> None:
        """Prints the configuration."""
        print(_as_yaml(_load(self.name, self.backbone, self.changes).to_dict()))


@flags
class Describe:
    """Say what settings mean: value, unit, what a larger one does, other names."""

    keys: Annotated[Positional[tuple[str, ...]], arg(metavar="KEY ...")]  # settings or sections
    config: Annotated[str, arg(metavar="NAME|FILE")] = "default"  # whose settings and values
    tracker: TrackerName = None

    def execute(self) -> None:
        """Prints a paragraph per setting."""
        if not self.keys:
            raise ConfigError("name the settings to describe, for example decision.new")
        config = _load(self.config, DEFAULT_BACKBONE, tracker=self.tracker)
        for line in describe_settings(config, self.keys):
            print_lines(line)


@flags
class Diff:
    """Print the keys whose values differ in runs with two configurations."""

    first: Annotated[Positional[str], arg(metavar="CONFIG")]  # name, or YAML file
    second: Annotated[Positional[str], arg(metavar="[CONFIG]")] = "default"  # name, or YAML file
    backbone: BackboneName = DEFAULT_BACKBONE  # some thresholds fit it

    def execute(self) -> None:
        """Prints one line per differing key; settings that only one tracker has are counted."""
        first, second = (_load(name, self.backbone) for name in (self.first, self.second))
        shared = set(first.keys) & set(second.keys)
        lines = [
            f"{key}: {mine!r} -> {theirs!r}"
            for key, mine, theirs in first.difference(second)
            if key in shared
        ]
        for name, config in ((self.first, first), (self.second, second)):
            if num := len(set(config.keys) - shared):
                lines.append(f"only in {name}: {num} settings of tracker '{config.tracker}'")
        print_lines(*lines)


@flags
class Validate:
    """Check configurations; the first unknown key or wrong value gives exit code 1."""

    files: Annotated[Positional[tuple[str, ...]], arg(metavar="CONFIG ...")]  # names, or YAML files

    def execute(self) -> None:
        """Prints one line per valid configuration."""
        if not self.files:
            raise ConfigError("name the configurations to check, for example mine.yaml")
        for name in self.files:
            load_config_with(name)
            print(f"{name} is valid")


@flags
class ImportReference:
    """Translate settings of the original implementation: what differs from published."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]  # the original's YAML
    out: Path | None = None  # write to this file instead of printing

    def execute(self) -> None:
        """Prints or writes the translation."""
        from remind_jax.config import Config, load_config
        from remind_jax.config.dotted_keys import nest

        imported = Config.from_reference(self.file)
        changes = {key: value for key, value, _ in imported.difference(load_config("published"))}
        tree = {"base": "published", **nest(changes)}
        if self.out is None:
            print(_as_yaml(tree))
        else:
            refuse_file(self.out, [self.file])
            with writing(self.out):
                self.out.write_text(_as_yaml(tree) + "\n", encoding="utf-8")


@flags
class ConfigVerb:
    """Print, describe, compare, check and import configurations.

    Examples:
      remind config show default > mine.yaml
      remind config describe decision.new looks
      remind config show --backbone dinov3-vits16
      remind config diff mine.yaml
      remind config validate mine.yaml
      remind config import-reference remind.yaml --out imported.yaml
    """

    action: (
        Annotated[List, subcommand("list")]
        | Annotated[Show, subcommand("show")]
        | Annotated[Describe, subcommand("describe")]
        | Annotated[Diff, subcommand("diff")]
        | Annotated[Validate, subcommand("validate")]
        | Annotated[ImportReference, subcommand("import-reference")]
    )

    def execute(self) -> None:
        """Does what was chosen."""
        self.action.execute()


def _load(
    name: str, backbone: str, changes: Assignments = (), tracker: str | None = None
) -> Config:
    """The values that run: the profile of the backbone is filled in."""
    from remind_jax.backbone.opening import open_backbone
    from remind_jax.config.profiles import has_profile

    check_name(backbone)
    config = load_config_with(name, changes, tracker)
    # The fingerprint of a network takes its weights, which are there where it was calibrated.
    if ":" in backbone or "+" in backbone or has_profile(config.tracker, backbone):
        return config.for_backbone(*open_backbone(backbone).identity)
    return config.for_backbone(backbone)


def _as_yaml(values: dict[str, Any]) -> str:
    import yaml

    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None).rstrip()


def describe_settings(config: Config, names: Sequence[str]) -> Iterator[str]:
    """A few lines about every setting that is named.

    Raises:
      ConfigError: If one of them is unknown, or may be several.
    """
    from remind_jax.config.keys import full_key, keys_below
    from remind_jax.settings.record import walk_settings

    settings = {key: (value, record) for key, value, record in walk_settings(config)}
    del settings["chosen"]
    for name in names:
        found = keys_below(name, settings) or [
            full_key(name, settings, config.tracker, "'remind config describe'")
        ]
        for key in found:
            value, record = settings[key]
            shown = str(value).lower() if isinstance(value, bool) else value
            yield f"{key}: {shown}{f' ({record.unit})' if record.unit else ''}"
            for head, words in (
                ("", record.meaning),
                ("larger: ", record.more),
                (f"at most {record.most}: ", record.why),
                ("in the paper: ", record.symbol),
                ("in the original: ", ", ".join((*record.own_keys, *record.decided_by))),
            ):
                if words:
                    yield f"  {head}{words}"
