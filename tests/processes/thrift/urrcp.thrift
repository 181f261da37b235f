/** The early form of URRCP over Apache Thrift: binary protocol, buffered transport, port 9090. */
service Urrcp {
  bool ping()
  string get_init_schema()
  oneway void set_config(1: string config_name, 2: string config_value)
  oneway void set_device_double_value(1: string device_id, 2: double value)
  double get_sensor_double_value(1: string sensor_id)
  string get_sensor_string_value(1: string sensor_id)
}
