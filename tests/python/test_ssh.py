"""packaging/ssh: SSH takes keys only and shows its banner."""

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from kestrel_harness import WORKSPACE, out_folder

FOLDER = WORKSPACE / "packaging" / "ssh"


def test_ssh_takes_keys_only_and_shows_its_banner():
    """The snippet forbids passwords and root and names the banner; where sshd is installed it must accept the file."""
    text = (FOLDER / "sshd_kestrel.conf").read_text()
    settings = dict(line.split(None, 1) for line in text.splitlines() if line and not line.startswith("#"))
    wanted = {
        "PasswordAuthentication": "no", "KbdInteractiveAuthentication": "no", "PubkeyAuthentication": "yes",
        "PermitRootLogin": "no", "LogLevel": "VERBOSE", "Banner": "/etc/ssh/kestrel_banner",
    }  # fmt: skip
    assert {k: settings.get(k) for k in wanted} == wanted, settings
    banner = (FOLDER / "kestrel_banner").read_text()
    assert "written down" in banner and len(banner.splitlines()) <= 4
    page = (WORKSPACE / "docs" / "deployment.md").read_text()
    for name in ("sshd_kestrel.conf", "kestrel_banner"):
        assert name in page, f"docs/deployment.md does not name {name}"
    sshd = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin:/usr/bin")
    if not sshd:
        return "read here; sshd is not installed to read it"
    folder = Path(tempfile.mkdtemp(prefix="sshd-", dir=out_folder()))
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / "key"], check=True, timeout=20)
    (folder / "conf").write_text(re.sub(r"^Banner .*", f"Banner {FOLDER}/kestrel_banner", text, flags=re.M) + f"HostKey {folder}/key\n")
    done = subprocess.run([sshd, "-t", "-f", folder / "conf"], capture_output=True, text=True, timeout=20)
    assert done.returncode == 0, done.stderr
    return "accepted by sshd"
