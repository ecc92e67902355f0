// A roscpp node: sends strings back reversed, adds numbers by way of a service, and calls one of ours.
#include <ros/ros.h>
#include <std_msgs/String.h>
#include <std_srvs/SetBool.h>
#include <algorithm>
#include <cstdio>

int main(int argc, char** argv) {
  ros::init(argc, argv, "cpp", ros::init_options::NoSigintHandler | ros::init_options::NoRosout);
  ros::NodeHandle node;
  ros::Publisher back = node.advertise<std_msgs::String>("/back", 100, true);
  ros::Subscriber there = node.subscribe<std_msgs::String>(
      "/there", 100,
      [&](const std_msgs::StringConstPtr& message) {
        std_msgs::String reversed;
        reversed.data.assign(message->data.rbegin(), message->data.rend());
        back.publish(reversed);
      });
  ros::ServiceServer flip = node.advertiseService<std_srvs::SetBool::Request, std_srvs::SetBool::Response>(
      "/flip", [](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
        response.success = !request.data;
        response.message = request.data ? "was on" : "was off";
        return request.data;
      });
  ros::ServiceClient ours = node.serviceClient<std_srvs::SetBool>("/ours", true);
  ros::AsyncSpinner spinner(1);
  spinner.start();
  std::puts("ready");
  std::fflush(stdout);
  if (ours.waitForExistence(ros::Duration(20))) {
    for (int round = 0; round < 3; ++round) {
      std_srvs::SetBool call;
      call.request.data = round % 2 == 0;
      const bool good = ours.call(call);
      std::printf("called %d %d %s\n", round, good, call.response.message.c_str());
      std::fflush(stdout);
      if (!good) ours = node.serviceClient<std_srvs::SetBool>("/ours", true);
    }
  }
  ros::waitForShutdown();
}
