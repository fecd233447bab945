"""`contained.py USER FOLDER... -- COMMAND...`: becomes a command without privileges that writes below folders alone."""

import ctypes
import os
import pwd
import shutil
import struct
import sys

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
ASK_VERSION, PATH_BENEATH = 1, 1
DROP_FROM_BOUNDING_SET, NO_NEW_PRIVILEGES = 24, 38
# Rights of <linux/landlock.h>: everything that changes a folder or a file; moving between folders since version 2,
# cutting short since 3.
WRITE_FILE, TRUNCATE = 1 << 1, 1 << 14
WRITE = {2: WRITE_FILE | sum(1 << bit for bit in range(4, 14)), 3: TRUNCATE}
# A container's own, which are not read-only.
ALWAYS = ("/dev", "/proc")

libc = ctypes.CDLL(None, use_errno=True)
libc.syscall.restype = ctypes.c_long


def call(number: int, *arguments: object) -> int:
    answer: int = libc.syscall(ctypes.c_long(number), *arguments)
    if answer < 0:
        raise OSError(ctypes.get_errno(), f"system call {number}")
    return answer


def drop_privileges() -> None:
    # Who is not root has none to drop, and may not say so.
    for capability in range(64):
        libc.prctl(DROP_FROM_BOUNDING_SET, capability, 0, 0, 0)
    if libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "no-new-privileges")


def write_below(folders: list[str]) -> None:
    try:
        version = call(CREATE_RULESET, None, ctypes.c_long(0), ctypes.c_long(ASK_VERSION))
    except OSError:
        return
    rights = sum(bits for since, bits in WRITE.items() if since <= version)
    if not rights:
        return
    attributes = struct.pack("=Q", rights)
    ruleset = call(CREATE_RULESET, attributes, ctypes.c_long(len(attributes)), ctypes.c_long(0))
    for folder in folders:
        descriptor = os.open(folder, os.O_PATH)
        rule = struct.pack("=Qi", rights, descriptor)
        call(ADD_RULE, ctypes.c_long(ruleset), ctypes.c_long(PATH_BENEATH), rule, ctypes.c_long(0))
        os.close(descriptor)
    call(RESTRICT_SELF, ctypes.c_long(ruleset), ctypes.c_long(0))
    os.close(ruleset)


def main() -> None:
    user, *arguments = sys.argv[1:]
    end = arguments.index("--")
    folders, command = arguments[:end], arguments[end + 1 :]
    program = shutil.which(command[0])  # the user may not be able to read this interpreter's library
    if program is None:
        sys.exit(f"there is no program {command[0]}")
    drop_privileges()
    if user:
        as_whom = pwd.getpwnam(user)
        os.setgroups([])
        os.setgid(as_whom.pw_gid)
        os.setuid(as_whom.pw_uid)
    write_below([*ALWAYS, *folders])
    os.execv(program, command)  # noqa: S606 - that is its purpose


if __name__ == "__main__":
    main()
