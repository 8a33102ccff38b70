"""What pyproject.toml says jaxcam needs is what its code imports."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions

from places import REPO

import jaxcam

PROJECT = tomllib.loads((REPO / "pyproject.toml").read_text())["project"]
MODULES = packages_distributions()

NOT_BY_IMPORT = {
    "opencv-contrib-python-headless": "replaces the build of OpenCV that robosuite asks for",
    "pynput": "robosuite imports it; ours is a version that needs no compiler",
    "tensorboardx": "jaxcam.training.loggers loads it by name",
    "wandb": "jaxcam.training.loggers loads it by name",
}
"""Declared packages that no import statement of jaxcam names, and why they are there."""
OF_DEVELOPERS = {"test", "dev", "docs"}
"""Extras whose packages are for the tests and tools."""


def normal(name):
    """A distribution's name in its one normal form."""
    return re.sub(r"[-_.]+", "-", name).lower()


def names(requirements):
    """Distributions that requirements name, without extras, versions and markers."""
    return {normal(re.match(r"[\w.-]+", requirement)[0]) for requirement in requirements}


def imports():
    """Each package outside the standard library that jaxcam imports, and a file that does."""
    imported = {}
    for path in sorted((REPO / "jaxcam").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                modules = [node.module]
            else:
                continue
            for module in modules:
                imported.setdefault(module.partition(".")[0], path.relative_to(REPO))
    return {name: path for name, path in imported.items() if name not in sys.stdlib_module_names}


def distributions(module):
    """Distributions that bring a module; one that is not installed is called as the module is."""
    return {normal(name) for name in MODULES.get(module, [module])}


def declared():
    """Distributions that jaxcam itself needs, always or for an extra."""
    extras = PROJECT["optional-dependencies"]
    return names(PROJECT["dependencies"]).union(
        *(names(extra) for name, extra in extras.items() if name not in OF_DEVELOPERS)
    )


def test_every_import_is_declared():
    missing = {
        module: str(path)
        for module, path in imports().items()
        if module != "jaxcam" and not distributions(module) & declared()
    }
    assert missing == {}


def test_every_declared_package_is_imported():
    used = set().union(*(distributions(module) for module in imports()))
    assert declared() - used - set(NOT_BY_IMPORT) == set()
    assert set(NOT_BY_IMPORT) <= declared()


def test_every_place_has_the_same_version():
    """The release that is published, cited, imported and described."""
    version = PROJECT["version"]
    assert jaxcam.__version__ == version
    assert f"\nversion: {version}\n" in (REPO / "CITATION.cff").read_text()
    released = re.findall(r"^## \[([\d.]+)\]", (REPO / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert released[0] == version


def test_the_page_of_a_package_index_leads_nowhere_that_it_has_not():
    """Links and pictures of README.md that need the repository are left out of the metadata."""
    text = (REPO / "README.md").read_text()
    rules = tomllib.loads((REPO / "pyproject.toml").read_text())["tool"]["hatch"]
    for rule in rules["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    assert re.findall(r"\]\((?!https://)", text) == []
    assert "blue is" not in text  # no caption without its picture
    assert "docs/your-policy.md" in text
