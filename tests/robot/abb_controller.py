"""The EGM side of an ABB controller: sends EgmRobot by UDP, 250 times a second, and follows the answers."""

import socket
import time
from multiprocessing.connection import Connection

import numpy as np
from abb_robot_client._egm_protobuf import egm_pb2

RATE_HZ = 250.0
GAIN = 0.2  # of the way to the answered pose in each period, as EGM's position gain does


def main(connection: Connection, port: int) -> None:
    """Answers ("truth",) with millimetres and wxyz, ("answers",) with the last answers, and ("set", field, value)."""
    robot = {"pos": np.array([500.0, -100.0, 400.0]), "quat": np.array([0.0, 0.0, 1.0, 0.0])}
    state = {"motors": True, "rapid": True, "guided": True, "sending": True, "following": True}
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    udp.setblocking(False)
    answers: list[tuple[float, list[float], list[float]]] = []
    sequence, next_s = 0, time.monotonic()
    connection.send(port)
    while True:
        next_s += 1 / RATE_HZ
        sequence += 1
        if state["sending"]:
            udp.sendto(packed(robot, state, sequence), ("127.0.0.1", port))
        time.sleep(max(0.0, next_s - time.monotonic()))
        for pos, quat in received(udp):
            answers.append((time.monotonic(), pos, quat))
            if state["following"] and state["motors"] and state["guided"]:
                follow(robot, np.array(pos), np.array(quat))
        if connection.poll():
            what, *arguments = connection.recv()
            if what == "set":
                (robot if arguments[0] in robot else state)[arguments[0]] = arguments[1]
            connection.send(answers[-5000:] if what == "answers" else (robot["pos"], robot["quat"]))


def packed(robot: dict[str, np.ndarray], state: dict[str, bool], sequence: int) -> bytes:
    message = egm_pb2.EgmRobot()
    message.header.seqno, message.header.mtype = sequence, egm_pb2.EgmHeader.MSGTYPE_DATA
    for pose in (message.feedBack, message.planned):
        pose.joints.joints.extend([0.0] * 6)
        pose.cartesian.pos.x, pose.cartesian.pos.y, pose.cartesian.pos.z = robot["pos"]
        orient = pose.cartesian.orient
        orient.u0, orient.u1, orient.u2, orient.u3 = robot["quat"]
    message.motorState.state = 1 if state["motors"] else 2
    message.rapidExecState.state = 2 if state["rapid"] else 1
    message.mciState.state = 3 if state["guided"] else 2
    return message.SerializeToString()


def received(udp: socket.socket) -> list[tuple[list[float], list[float]]]:
    found = []
    while True:
        try:
            data = udp.recv(65536)
        except OSError:
            return found
        answer = egm_pb2.EgmSensor.FromString(data).planned.cartesian
        pos, orient = answer.pos, answer.orient
        found.append(([pos.x, pos.y, pos.z], [orient.u0, orient.u1, orient.u2, orient.u3]))


def follow(robot: dict[str, np.ndarray], pos: np.ndarray, quat: np.ndarray) -> None:
    robot["pos"] = robot["pos"] + GAIN * (pos - robot["pos"])
    mixed = robot["quat"] + GAIN * (quat * np.sign(quat @ robot["quat"]) - robot["quat"])
    robot["quat"] = mixed / np.linalg.norm(mixed)
