// A stand-in, see rclcpp/rclcpp.hpp.
#pragma once
#include <memory>

namespace geometry_msgs::msg
{
struct Header { double stamp = 0.0; };
struct Vector { double x = 0.0, y = 0.0, z = 0.0; };
struct Quaternion { double x = 0.0, y = 0.0, z = 0.0, w = 1.0; };
struct Pose { Vector position; Quaternion orientation; };
struct PoseStamped
{
  using SharedPtr = std::shared_ptr<PoseStamped>;
  Header header;
  Pose pose;
};
}  // namespace geometry_msgs::msg
