"""What happens to a node beside its samples: listeners of all it publishes, a parameter set every second.

python disturber.py
"""

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from serving import serve
from std_msgs.msg import Float64MultiArray

NODE = "/friction_estimator"
ARRAYS = ("friction_curve", "parameters/fir_taps", "parameters/theory_taps", "parameters/wavelet_weights")


def main() -> None:
    rclpy.init(args=["disturber"], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("disturber")
    for topic in ARRAYS:
        node.create_subscription(Float64MultiArray, f"{NODE}/{topic}", lambda _: None, 10, raw=True)
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda _: None, 10, raw=True)
    client = node.create_client(SetParameters, f"{NODE}/set_parameters")
    values = [0.004, 0.005]

    def set_one() -> None:
        if client.service_is_ready():
            values.reverse()
            parameter = Parameter("lms.step_size", value=values[0])
            client.call_async(SetParameters.Request(parameters=[parameter.to_parameter_msg()]))

    node.create_timer(1.0, set_one)
    serve(node, EventsExecutor(), "disturbing")


if __name__ == "__main__":
    main()
