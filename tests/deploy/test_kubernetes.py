"""The manifests for Kubernetes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from ropeway.gateway.config.config import parse
from tests.deploy.place import DEPLOY

MANIFESTS = [
    (file.name, document)
    for file in sorted((DEPLOY / "kubernetes").glob("*.yaml"))
    for document in yaml.safe_load_all(file.read_text("utf-8"))
]
WORKLOADS = [document for _, document in MANIFESTS if document["kind"] in ("Deployment", "StatefulSet")]


def _name(value: Any) -> str:
    return str(value["metadata"]["name"] + "-" + value["kind"]) if isinstance(value, dict) else str(value)


@pytest.mark.parametrize(("file", "document"), MANIFESTS, ids=_name)
def test_schema(file: str, document: dict[str, Any]) -> None:
    """Every object is valid by the schema of Kubernetes, with no key that it does not know."""
    validate = pytest.importorskip("kubernetes_validate")
    validate.validate(document, "1.30", strict=True)


@pytest.mark.parametrize("workload", WORKLOADS, ids=_name)
def test_nothing_more_than_needed(workload: dict[str, Any]) -> None:
    """A workload runs as the image's user, without capabilities, on a file system that it cannot write."""
    spec = workload["spec"]["template"]["spec"]
    assert spec["securityContext"]["runAsUser"] == 10001
    assert f"USER {spec['securityContext']['runAsUser']}:" in (DEPLOY / "Containerfile").read_text("utf-8")
    (container,) = spec["containers"]
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    mounted = {mount["name"] for mount in container["volumeMounts"]}
    claimed = {claim["metadata"]["name"] for claim in workload["spec"].get("volumeClaimTemplates", ())}
    assert mounted == {volume["name"] for volume in spec["volumes"]} | claimed


def test_configuration(tmp_path: Path) -> None:
    """The configuration in the ConfigMap is a valid one, and listens at the port of the probes and of the service."""
    (text,) = [document["data"]["gateway.yaml"] for _, document in MANIFESTS if document["kind"] == "ConfigMap"]
    (tmp_path / "token").write_text("t" * 32)
    config = parse(
        yaml.safe_load(text.replace("/run/secrets/ropeway", str(tmp_path))), "gateway.yaml", directory=tmp_path
    )
    assert config.gateway.listen == ("ws://0.0.0.0:9090",)
