// A stand-in, see rclcpp/rclcpp.hpp.
#pragma once
#include "geometry_msgs/msg/pose_stamped.hpp"

namespace geometry_msgs::msg
{
struct Wrench { Vector force, torque; };
struct WrenchStamped { Header header; Wrench wrench; };
}  // namespace geometry_msgs::msg
