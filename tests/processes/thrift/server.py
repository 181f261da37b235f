"""A robot of the Thrift form: serves one connection at a time, and logs every value that is set with its time.

usage: server.py PORT SCHEMA LOG    (port 0: any free one; it is printed)
"""

import os
import sys
import time

import thriftpy2
from thriftpy2.protocol import TBinaryProtocolFactory
from thriftpy2.server import TSimpleServer
from thriftpy2.thrift import TProcessor
from thriftpy2.transport import TBufferedTransportFactory, TServerSocket

HERE = os.path.dirname(os.path.abspath(__file__))
urrcp = thriftpy2.load(os.path.join(HERE, "urrcp.thrift"), module_name="urrcp_thrift")


class Robot:
    def __init__(self, schema, log):
        self.schema = schema
        self.log = log
        self.values = {}

    def ping(self):
        return True

    def get_init_schema(self):
        return self.schema

    def set_config(self, config_name, config_value):
        pass

    def set_device_double_value(self, device_id, value):
        self.values[device_id] = value
        self.log.write(f"{time.time():.6f} {device_id} {value:g}\n")
        self.log.flush()

    def get_sensor_double_value(self, sensor_id):
        return 12.5 if sensor_id == "battery" else self.values[sensor_id]

    def get_sensor_string_value(self, sensor_id):
        return "12.5"


def main():
    port, schema, log = sys.argv[1:]
    with open(schema) as file:
        robot = Robot(file.read(), open(log, "a"))
    listener = TServerSocket(host="127.0.0.1", port=int(port), client_timeout=None)
    listener.listen()
    print(listener.sock.getsockname()[1], flush=True)
    listener.listen = lambda: None
    processor = TProcessor(urrcp.Urrcp, robot)
    TSimpleServer(processor, listener, TBufferedTransportFactory(), TBinaryProtocolFactory()).serve()


if __name__ == "__main__":
    main()
