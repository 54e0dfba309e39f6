model CartesianPendulum "A point mass on a rod in Cartesian coordinates: index 3, two states"
  parameter Real m(unit="kg", min=1.5, max=2.5) = 2;
  parameter Real L(unit="m", min=0.6, max=1.2) = 0.8;
  parameter Real g(unit="m/s2") = 9.81;
  parameter Real d(unit="N.s/m") = 0.1 "drag of the air";
  input Real f(unit="N", start=0) "horizontal force on the mass";
  Real x(unit="m", start=0);
  Real y(unit="m", start=-0.8);
  Real v_x(unit="m/s", start=0);
  Real v_y(unit="m/s", start=0);
  Real lambda(unit="N/m", start=20) "force of the rod over its length";
  output Real position(unit="m") = x;
equation
  der(x) = v_x;
  der(y) = v_y;
  m*der(v_x) = -lambda*x - d*v_x + f;
  m*der(v_y) = -lambda*y - d*v_y - m*g;
  x^2 + y^2 = L^2;
end CartesianPendulum;
