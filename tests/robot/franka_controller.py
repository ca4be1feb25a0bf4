"""franky-sim: the protocol of a Franka controller on the dynamics of MuJoCo."""

from multiprocessing.connection import Connection

import numpy as np
from franky_sim import SimulationServer
from franky_sim.franka_robot_protocol import MoveStatus, RobotCommand
from franky_sim.franka_server import BaseCommand
from franky_sim.mujoco_simulator import MujocoSimulator


def main(connection: Connection) -> None:
    """Answers ("truth",) with MuJoCo's pose of the hand and its clock; ("reflex",) aborts the motion."""
    with MujocoSimulator(enable_visualization=False) as simulator:
        robot = simulator.add_robot()
        with SimulationServer(simulator) as server:
            connection.send(robot.hostname)
            while True:
                server.run_once()
                if connection.poll():
                    if connection.recv() == ("reflex",):
                        _abort(robot.server)
                    connection.send((_hand(simulator.data), simulator.data.time))


def _hand(data: object) -> np.ndarray:
    body = data.body("robot0_hand")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return T


def _abort(server: object) -> None:
    """What a controller does on a collision: the motion ends by a reflex."""
    motion_id = server.current_motion_id
    server.stop_motion(send_preemption_signal=False)
    BaseCommand.send_response(server._tcp_socket, RobotCommand.kMove, motion_id, MoveStatus.kReflexAborted)
    server.reset_current_motion_id()
