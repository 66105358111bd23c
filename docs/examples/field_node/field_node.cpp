// A node of ROS 2 over fieldmap.h: what the field of a map does to a magnet, at every pose that comes in.
//
// Subscribes to `magnet_pose` (geometry_msgs/PoseStamped, in the frame of the map, m) and `currents`
// (std_msgs/Float64MultiArray, A, in the order of the coils; none before the first message). Publishes `magnet_wrench`
// (geometry_msgs/WrenchStamped, N and N m about the magnet, in the frame of the map) with the stamp of the pose.
// Parameters: `map`, a file of `fieldmap export MAP --to c`; `moment`, A m^2, in the frame of the magnet. At a pose
// outside the map it publishes nothing and warns.
//
// This file was compiled and called through stand-ins for the few names of rclcpp that it uses
// (tests/interop/test_host_examples.py). It was never built or run with ROS 2.
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "fieldmap.h"
#include "geometry_msgs/msg/pose_stamped.hpp"
#include "geometry_msgs/msg/wrench_stamped.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

class FieldNode : public rclcpp::Node
{
public:
  FieldNode() : Node("fieldmap"), map_()
  {
    const std::string path = declare_parameter<std::string>("map", "linear.fmap");
    moment_ = declare_parameter<std::vector<double>>("moment", {0.0, 0.0, 1.0});
    const int status = fieldmap_open(&map_, path.c_str());
    if (status != FIELDMAP_OK) throw std::runtime_error(path + ": " + fieldmap_message(status));
    if (moment_.size() != 3) throw std::runtime_error("moment: three numbers, A m^2");
    currents_.assign(static_cast<std::size_t>(map_.n_coils), 0.0);
    wrench_ = create_publisher<geometry_msgs::msg::WrenchStamped>("magnet_wrench", 10);
    amperes_ = create_subscription<std_msgs::msg::Float64MultiArray>(
      "currents", 10, [this](std_msgs::msg::Float64MultiArray::SharedPtr said) { set_currents(*said); });
    pose_ = create_subscription<geometry_msgs::msg::PoseStamped>(
      "magnet_pose", 10, [this](geometry_msgs::msg::PoseStamped::SharedPtr said) { answer(*said); });
  }

  ~FieldNode() { fieldmap_close(&map_); }

private:
  void set_currents(const std_msgs::msg::Float64MultiArray & said)
  {
    if (said.data.size() == currents_.size()) {
      currents_ = said.data;
    } else {
      RCLCPP_WARN(get_logger(), "currents: %zu numbers for %zu coils", said.data.size(), currents_.size());
    }
  }

  void answer(const geometry_msgs::msg::PoseStamped & said)
  {
    const auto & at = said.pose.position;
    const auto & q = said.pose.orientation;
    const double place[3] = {at.x, at.y, at.z};
    const double s = 2.0 / (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    const double turn[9] = {
      1.0 - s * (q.y * q.y + q.z * q.z), s * (q.x * q.y - q.w * q.z), s * (q.x * q.z + q.w * q.y),
      s * (q.x * q.y + q.w * q.z), 1.0 - s * (q.x * q.x + q.z * q.z), s * (q.y * q.z - q.w * q.x),
      s * (q.x * q.z - q.w * q.y), s * (q.y * q.z + q.w * q.x), 1.0 - s * (q.x * q.x + q.y * q.y)};
    double moment[3], wrench[6];
    for (int i = 0; i < 3; i++)
      moment[i] = turn[3 * i] * moment_[0] + turn[3 * i + 1] * moment_[1] + turn[3 * i + 2] * moment_[2];
    const int status = fieldmap_wrench(&map_, currents_.data(), place, moment, wrench);
    if (status != FIELDMAP_OK) {
      RCLCPP_WARN(get_logger(), "magnet_pose: %s", fieldmap_message(status));
      return;
    }
    geometry_msgs::msg::WrenchStamped found;
    found.header = said.header;
    found.wrench.force.x = wrench[0];
    found.wrench.force.y = wrench[1];
    found.wrench.force.z = wrench[2];
    found.wrench.torque.x = wrench[3];
    found.wrench.torque.y = wrench[4];
    found.wrench.torque.z = wrench[5];
    wrench_->publish(found);
  }

  fieldmap map_;
  std::vector<double> moment_, currents_;
  rclcpp::Publisher<geometry_msgs::msg::WrenchStamped>::SharedPtr wrench_;
  rclcpp::Subscription<std_msgs::msg::Float64MultiArray>::SharedPtr amperes_;
  rclcpp::Subscription<geometry_msgs::msg::PoseStamped>::SharedPtr pose_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<FieldNode>());
  rclcpp::shutdown();
  return 0;
}
