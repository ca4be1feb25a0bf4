"""A controller of Universal Robots: RTDE state on port 30004, and a few lines of URScript on port 30002."""

import re
import select
import socket
import struct
import time
from multiprocessing.connection import Connection

import numpy as np

from reorient import se3, so3

ADDRESS = "127.0.0.1"
RATE_HZ = 125.0
TYPES = {
    "timestamp": ("DOUBLE", ">d"),
    "actual_TCP_pose": ("VECTOR6D", ">6d"),
    "robot_mode": ("INT32", ">i"),
    "safety_status_bits": ("UINT32", ">I"),
    "robot_status_bits": ("UINT32", ">I"),
    "runtime_state": ("UINT32", ">I"),
}
MOVEL = re.compile(r"movel\(p\[(.*?)\], a=(.*?), v=(.*?), t=(.*?)\)")


class Robot:
    """The state that RTDE reports, and the motion of the program that runs."""

    def __init__(self) -> None:
        self.T = se3.transform(so3.exp(np.array([np.pi, 0.0, 0.0])), np.array([0.4, -0.1, 0.3]))
        self.path: tuple[np.ndarray, np.ndarray, float, float] | None = None
        self.runtime_state, self.robot_mode, self.safety_bits = 1, 7, 1
        self.remote, self.speed, self.programs = True, 1.0, []

    def run(self, program: str) -> None:
        self.programs.append(program)
        if not self.remote or self.safety_bits != 1:
            return
        self.path, self.runtime_state = None, 1
        if move := MOVEL.search(program):
            values = np.array([float(x) for x in move[1].split(",")])
            goal = se3.transform(so3.exp(values[3:]), values[:3])
            self.path, self.runtime_state = (self.T, goal, time.monotonic(), float(move[4])), 2

    def step(self) -> None:
        if self.path is None or self.runtime_state != 2:
            return
        start, goal, since_s, duration_s = self.path
        s = min(1.0, self.speed * (time.monotonic() - since_s) / duration_s)
        rotvec = so3.log(goal[:3, :3] @ start[:3, :3].T)
        self.T = se3.transform(so3.exp(s * rotvec) @ start[:3, :3], (1 - s) * start[:3, 3] + s * goal[:3, 3])
        if s == 1:
            self.path, self.runtime_state = None, 1

    def stop_by_safety(self, bit: int) -> None:
        self.safety_bits, self.path, self.runtime_state = 1 << bit, None, 1

    def packed(self, name: str) -> bytes:
        values = {
            "timestamp": (time.monotonic(),),
            "actual_TCP_pose": (*self.T[:3, 3], *so3.log(self.T[:3, :3])),
            "robot_mode": (self.robot_mode,),
            "safety_status_bits": (self.safety_bits,),
            "robot_status_bits": (3,),
            "runtime_state": (self.runtime_state,),
        }
        return struct.pack(TYPES[name][1], *values[name])


class RtdeClient:
    """One connection to port 30004."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection, self.buffer, self.names, self.running = connection, b"", [], False

    def handle(self, data: bytes) -> None:
        self.buffer += data
        while len(self.buffer) >= 3:
            length, kind = struct.unpack(">HB", self.buffer[:3])
            if len(self.buffer) < length:
                return
            payload, self.buffer = self.buffer[3:length], self.buffer[length:]
            answers = {"V": b"\x01", "v": struct.pack(">IIII", 5, 11, 0, 0), "S": b"\x01", "P": b"\x01"}
            answer = answers.get(chr(kind), b"")
            if chr(kind) == "O":
                self.names = payload[8:].decode().strip(",").split(",")
                answer = b"\x01" + ",".join(TYPES[name][0] for name in self.names).encode()
            self.running = {"S": True, "P": False}.get(chr(kind), self.running)
            self.send(kind, answer)

    def send(self, kind: int, payload: bytes) -> None:
        self.connection.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)


def listening(port: int) -> socket.socket:
    server = socket.socket()
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    server.bind((ADDRESS, port))
    server.listen()
    return server


def main(connection: Connection) -> None:
    """Answers ("truth",) with the pose, ("programs",) with the texts, ("set", field, value) and ("safety", bit)."""
    robot, rtde, script = Robot(), listening(30004), listening(30002)
    rtde_clients: list[RtdeClient] = []
    script_clients: dict[socket.socket, str] = {}
    connection.send(ADDRESS)
    next_s = time.monotonic()
    while True:
        sockets = [rtde, script, *[client.connection for client in rtde_clients], *script_clients]
        ready, _, _ = select.select(sockets, [], [], max(0.0, next_s - time.monotonic()))
        for each in ready:
            if each is rtde:
                rtde_clients.append(RtdeClient(each.accept()[0]))
            elif each is script:
                client = each.accept()[0]
                client.sendall(b"\x00\x00\x00\x05\x14")  # the first state message of the real one is longer
                script_clients[client] = ""
            elif each in script_clients:
                read_script(robot, script_clients, each)
            else:
                read_rtde(rtde_clients, each)
        if time.monotonic() >= next_s:
            next_s += 1 / RATE_HZ
            robot.step()
            for client in rtde_clients:
                if client.running:
                    client.send(ord("U"), b"\x01" + b"".join(robot.packed(name) for name in client.names))
        if connection.poll():
            connection.send(answer(robot, rtde_clients, *connection.recv()))


def read_script(robot: Robot, clients: dict[socket.socket, str], each: socket.socket) -> None:
    data = each.recv(65536)
    clients[each] += data.decode()
    if not data:
        robot.run(clients.pop(each))
        each.close()


def read_rtde(clients: list[RtdeClient], each: socket.socket) -> None:
    client = next(client for client in clients if client.connection is each)
    try:
        data = each.recv(65536)
    except OSError:
        data = b""
    if data:
        client.handle(data)
    else:
        clients.remove(client)


def answer(robot: Robot, clients: list[RtdeClient], what: str, *arguments: object) -> object:
    if what == "set":
        setattr(robot, *arguments)
    elif what == "safety":
        robot.stop_by_safety(*arguments)
    elif what == "silent":
        for client in clients:
            client.running = False
    return robot.programs if what == "programs" else robot.T
