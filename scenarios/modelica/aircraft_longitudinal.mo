model AircraftLongitudinal "A light aircraft in its plane of symmetry, with lift and moment from tables over the angle of attack"
  constant Real g(unit="m/s2") = 9.81;
  parameter Real m(unit="kg") = 1200;
  parameter Real I(unit="kg.m2", min=1500, max=2200) = 1825 "about the lateral axis";
  parameter Real x_cg(min=-0.05, max=0.05) = 0 "shift of the center of mass to the tail, over the chord";
  parameter Real rho(unit="kg/m3") = 1.058 "at 1500 m";
  parameter Real S(unit="m2") = 16.2;
  parameter Real c(unit="m") = 1.49;
  parameter Real C_D0 = 0.032;
  parameter Real k_D = 0.054 "of the induced drag";
  parameter Real C_mq(min=-15, max=-10) = -12.4 "damping in pitch";
  parameter Real C_mde = -1.28;
  parameter Integer n = 6;
  parameter Real table[n,3] = [
    -0.15, -0.40,  0.110;
    -0.05,  0.09,  0.045;
     0.05,  0.58, -0.035;
     0.12,  0.91, -0.105;
     0.19,  1.19, -0.195;
     0.26,  1.36, -0.300] "angle of attack (rad), lift and moment coefficient at rest";
  parameter Real slope_L[n - 1] = {(table[k + 1, 2] - table[k, 2])/(table[k + 1, 1] - table[k, 1]) for k in 1:n - 1};
  parameter Real slope_m[n - 1] = {(table[k + 1, 3] - table[k, 3])/(table[k + 1, 1] - table[k, 1]) for k in 1:n - 1};
  input Real elevator(unit="rad", start=-0.01);
  input Real thrust(unit="N", start=1100);
  Real V(unit="m/s", start=55, nominal=50);
  Real alpha(unit="rad", start=0.02);
  Real q(unit="rad/s", start=0);
  Real theta(unit="rad", start=0.02);
  Real C_L;
  Real C_D;
  Real C_m;
  Real pressure(unit="Pa", nominal=1000) "dynamic pressure";
  Real lift(unit="N", nominal=1e4);
  Real drag(unit="N", nominal=1e3);
  output Real speed(unit="m/s") = V;
  output Real climb(unit="rad") = theta - alpha;
equation
  C_L = table[1, 2] + slope_L[1]*(alpha - table[1, 1])
    + sum({(slope_L[k] - slope_L[k - 1])*max(0, alpha - table[k, 1]) for k in 2:n - 1});
  C_m = table[1, 3] + slope_m[1]*(alpha - table[1, 1])
    + sum({(slope_m[k] - slope_m[k - 1])*max(0, alpha - table[k, 1]) for k in 2:n - 1})
    + C_mq*q*c/(2*V) + C_mde*elevator + x_cg*C_L;
  C_D = C_D0 + k_D*C_L^2;
  pressure = rho*V^2/2;
  lift = pressure*S*C_L;
  drag = pressure*S*C_D;
  m*der(V) = thrust*cos(alpha) - drag - m*g*sin(theta - alpha);
  m*V*(q - der(alpha)) = lift + thrust*sin(alpha) - m*g*cos(theta - alpha);
  I*der(q) = pressure*S*c*C_m;
  der(theta) = q;
end AircraftLongitudinal;
