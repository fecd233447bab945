"""The service behind a real nginx and a real Caddy with TLS, set up as `examples/proxy/` has it."""

import shutil
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from live_service import wait_until
from missing_parts import free_port, skip_without
from results import SCANNER_SPEC

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples/proxy"
NAME, BACKEND = "calibration.mill.example", "127.0.0.1:8000"
CERTIFICATE, SECRET_KEY = f"/etc/ssl/certs/{NAME}.pem", f"/etc/ssl/private/{NAME}.key"
WAIT_S = 120.0
# Another address of this machine: what a proxy on 127.0.0.1 sees is then not its own.
CLIENT = "127.0.0.7"
NGINX_MAIN = """\
daemon off; pid {folder}/nginx.pid; error_log {folder}/nginx.log;
events {{}}
http {{
  access_log off;
  client_body_temp_path {folder}/a; proxy_temp_path {folder}/b; fastcgi_temp_path {folder}/c;
  uwsgi_temp_path {folder}/d; scgi_temp_path {folder}/e;
  {site}
}}
"""
# Limits that the test of half heads and half bodies reaches in seconds.
SHORTENED = {
    "nginx": {"client_header_timeout 10s": "client_header_timeout 2s", "body_timeout 60s": "body_timeout 5s"},
    "caddy": {"read_header 10s": "read_header 2s", "read_body 1h": "read_body 5s"},
}


def program(name: str) -> str:
    found = shutil.which(name) or shutil.which(name, path="/usr/sbin")
    if found is None:
        skip_without(f"this test needs Debian's {name}: apt-get install {name}")
    return found


@contextmanager
def listening(command: list[str], port: int, **options: object) -> Iterator[None]:
    """Run a server within the block, which begins when something listens on its port."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, **options)

    def accepts() -> bool:
        assert process.poll() is None
        with suppress(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
            return True
        return False

    try:
        wait_until(accepts)
        yield
    finally:
        process.terminate()
        process.wait(WAIT_S)


@dataclass
class Mill:
    """A service, what its settings say of its proxy, and the certificate of that."""

    folder: Path
    variables: dict[str, str]
    port: int
    backend: int

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def sawmill(self, *arguments: str) -> list[str]:
        return [str(Path(sys.executable).with_name("sawmill")), *arguments, "--data", str(self.data)]

    def administrator(self) -> dict[str, str]:
        made = self.sawmill("key", "create", "--name", "anna", "--scope", "admin")
        secret = subprocess.run(made, env=self.variables, capture_output=True, text=True, check=True).stdout.strip()
        return {"Authorization": f"Bearer {secret}"}

    @contextmanager
    def serving(self, **variables: str) -> Iterator[None]:
        serve = self.sawmill("serve", "--port", str(self.backend), "--workers", "0", "--no-examples")
        with (
            (self.folder / "service.log").open("ab") as log,
            listening(serve, self.backend, env=self.variables | variables, stderr=log),
        ):
            yield

    def example(self, name: str) -> str:
        text = (EXAMPLES / name).read_text()
        for line in (CERTIFICATE, SECRET_KEY, NAME, BACKEND):
            assert line in text
        text = text.replace(CERTIFICATE, f"{self.folder}/certificate.pem").replace(SECRET_KEY, f"{self.folder}/key.pem")
        return text.replace(BACKEND, f"127.0.0.1:{self.backend}")

    def shortened(self, name: str, limits: dict[str, str]) -> str:
        text = self.example(name)
        for line, short in limits.items():
            assert text.count(line) == 1
            text = text.replace(line, short)
        return text

    @contextmanager
    def nginx(self, site: str) -> Iterator[None]:
        configuration = self.folder / "nginx.conf"
        configuration.write_text(NGINX_MAIN.format(folder=self.folder, site=site))
        with listening([program("nginx"), "-c", str(configuration), "-e", f"{self.folder}/nginx.log"], self.port):
            yield

    @contextmanager
    def caddy(self, limits: dict[str, str]) -> Iterator[None]:
        options = "{\n\tadmin off\n\tgrace_period 2s\n\tauto_https disable_redirects\n\tdefault_bind 127.0.0.1\n"
        site = self.shortened("Caddyfile", limits).replace(f"{NAME} {{", f"https://{NAME}:{self.port} {{")
        assert site.count("\n{\n") == 1
        file = self.folder / "Caddyfile"
        file.write_text(site.replace("\n{\n", f"\n{options}"))
        homes = {"HOME": str(self.folder), "XDG_DATA_HOME": str(self.folder), "XDG_CONFIG_HOME": str(self.folder)}
        command = [program("caddy"), "run", "--config", str(file)]
        with listening(command, self.port, env=self.variables | homes, stderr=subprocess.DEVNULL):
            yield

    @contextmanager
    def client(self) -> Iterator[httpx.Client]:
        """Calls the proxy by its name, from another address of this machine."""
        transport = httpx.HTTPTransport(verify=self.trusted(), local_address=CLIENT)
        at = {"base_url": f"https://127.0.0.1:{self.port}", "headers": {"Host": f"{NAME}:{self.port}"}}
        with httpx.Client(transport=transport, timeout=WAIT_S, **at) as client:
            yield client

    def trusted(self) -> ssl.SSLContext:
        return ssl.create_default_context(cafile=f"{self.folder}/certificate.pem")


def prepared(folder: Path, variables: dict[str, str]) -> Mill:
    subprocess.run(
        [
            program("openssl"), "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
            "-keyout", "key.pem", "-out", "certificate.pem", "-days", "1", "-subj", f"/CN={NAME}",
            "-addext", f"subjectAltName=DNS:{NAME},IP:127.0.0.1",
        ],
        cwd=folder, capture_output=True, check=True,
    )  # fmt: skip
    return Mill(folder, variables, free_port(), free_port())


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory, offline) -> Iterator[tuple[Mill, dict[str, str]]]:
    """A service that trusts a proxy on this machine, for one after the other, and its administrator's headers."""
    mill = prepared(tmp_path_factory.mktemp("guarded"), offline.variables)
    admin = mill.administrator()
    behind = {"SAWMILL_PUBLIC_URL": f"https://{NAME}", "SAWMILL_TRUSTED_PROXIES": '["127.0.0.1"]'}
    with mill.serving(**behind, SAWMILL_LOG_FORMAT="json"):
        yield mill, admin


@contextmanager
def in_front(mill: Mill, proxy: str, limits: dict[str, str] | None = None) -> Iterator[None]:
    if proxy == "caddy":
        with mill.caddy(limits or {}):
            yield
        return
    site = mill.shortened("nginx.conf", limits or {})
    with mill.nginx(site.replace("listen 443 ssl", f"listen 127.0.0.1:{mill.port} ssl")):
        yield


@pytest.mark.parametrize("proxy", ["nginx", "caddy"])
def test_behind_the_documented_proxy_keys_are_needed_and_clients_have_their_own_address(guarded, proxy):
    program(proxy)
    mill, admin = guarded
    secret = admin["Authorization"].partition(" ")[2]
    with in_front(mill, proxy), mill.client() as client:
        assert (client.get("/health/live").status_code, client.get("/v1/scanners").status_code) == (200, 401)
        forged = {"X-Forwarded-For": "127.0.0.1"}
        assert client.get("/v1/scanners", headers=forged).status_code == 401
        made = client.post("/v1/keys", json={"name": "line 2", "scope": "submit"}, headers=admin).json()
        submit = {"Authorization": f"Bearer {made['secret']}"}
        assert client.post("/v1/scanners", json=SCANNER_SPEC, headers=submit).status_code == 403
        scanner = client.post("/v1/scanners", json=SCANNER_SPEC, headers=admin | forged).json()["id"]
        entry = client.get("/v1/audit", params={"limit": 1}, headers=admin).json()["items"][0]
        assert (entry["action"], entry["who"], entry["address"]) == ("scanner-created", "anna", CLIENT)
        # Three megabytes, which pass through as they come.
        sent = {"content": (bytes(2**16) for _ in range(48)), "params": {"scanner_id": scanner, "data": "counts"}}
        upload = client.post("/v1/scans", **sent, headers=submit)
        assert (upload.status_code, upload.json()["size_bytes"]) == (202, 3 * 2**20)
        with client.stream("GET", f"/v1/jobs/{upload.json()['job_id']}/events", headers=submit) as stream:
            # No worker runs: the first event arrives while the stream goes on.
            assert next(stream.iter_lines()).startswith("event: job")
        fields = {"key": secret, "next": "/docs"}
        login = client.post("/login", data=fields, headers={"Origin": f"https://{NAME}:{mill.port}"})
        assert (login.status_code, login.headers["Location"]) == (303, "/docs")
        cookie = login.headers["Set-Cookie"]
        assert cookie.startswith("__Host-sawmill_session=")
        assert {"Secure", "HttpOnly"} <= {part.strip() for part in cookie.split(";")}
        assert client.get("/").status_code == 200
        # A refusal reaches a client that still sends.
        large = client.post("/v1/scanners", content=bytes(20_000_000), headers=admin)
        assert (large.status_code, large.json()["code"]) == (413, "body-too-large")
    assert secret not in (mill.folder / "service.log").read_text()


def tls(mill: Mill) -> ssl.SSLSocket:
    connection = socket.create_connection(("127.0.0.1", mill.port), timeout=WAIT_S)
    return mill.trusted().wrap_socket(connection, server_hostname=NAME)


def read_until_the_end(connection: ssl.SSLSocket) -> bytes:
    """What comes until the proxy has ended the connection, in order or not."""
    received = b""
    with suppress(ConnectionError, ssl.SSLError):
        while part := connection.recv(2**16):
            received += part
    return received


@pytest.mark.parametrize("proxy", ["nginx", "caddy"])
def test_the_documented_proxy_ends_half_heads_and_bodies_that_stand_still(guarded, proxy):
    program(proxy)
    mill, admin = guarded
    head = f"Host: {NAME}:{mill.port}\r\nAuthorization: {admin['Authorization']}\r\nContent-Length: 1000\r\n\r\n"
    incoming = mill.data / "incoming"
    with in_front(mill, proxy, SHORTENED[proxy]):
        with mill.client() as client:
            scanner = client.post("/v1/scanners", json=SCANNER_SPEC, headers=admin).json()["id"]
        with tls(mill) as connection:
            connection.sendall(b"GET /health/live HTTP/1.1\r\nHost: ")
            assert b"alive" not in read_until_the_end(connection)
        with tls(mill) as connection:
            connection.sendall(f"POST /v1/scans?scanner_id={scanner}&data=counts HTTP/1.1\r\n{head}half".encode())
            wait_until(lambda: list(incoming.iterdir()))
            assert b" 202 " not in read_until_the_end(connection)
        wait_until(lambda: not list(incoming.iterdir()))


def test_behind_a_proxy_it_does_not_start_without_a_key(tmp_path, offline):
    mill = prepared(tmp_path, offline.variables)
    variables = {"SAWMILL_PUBLIC_URL": f"https://{NAME}"}
    serve = mill.sawmill("serve", "--port", str(mill.backend), "--workers", "0", "--no-examples")
    options = {"capture_output": True, "text": True, "timeout": WAIT_S}
    done = subprocess.run(serve, env=mill.variables | variables, check=False, **options)
    assert done.returncode == 1
    assert "so each must bring a key: make one with sawmill key create" in done.stderr
    assert "Traceback" not in done.stderr
    assert not mill.data.exists()
