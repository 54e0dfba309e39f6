model CoupledInertias "Two inertias on one rigid shaft: as components of their own they have four states, together two"
  connector RealInput = input Real;

  connector Flange
    Real phi(unit="rad");
    flow Real tau(unit="N.m");
  end Flange;

  model Inertia
    parameter Real J(unit="kg.m2") = 1;
    Flange a;
    Flange b;
    Real phi(unit="rad", start=0);
    Real w(unit="rad/s", start=0);
  equation
    phi = a.phi;
    phi = b.phi;
    w = der(phi);
    J*der(w) = a.tau + b.tau;
  end Inertia;

  model Support "Spring and damper to the ground"
    parameter Real c(unit="N.m/rad") = 1;
    parameter Real d(unit="N.m.s/rad") = 0;
    Flange a;
    Real w(unit="rad/s");
  equation
    w = der(a.phi);
    a.tau = c*a.phi + d*w;
  end Support;

  model Torque
    RealInput tau(unit="N.m");
    Flange b;
  equation
    b.tau = -tau;
  end Torque;

  parameter Real J1(unit="kg.m2", min=0.5, max=1.5) = 1;
  parameter Real J2(unit="kg.m2", min=1, max=4) = 2;
  Torque torque;
  Inertia first(J=J1);
  Inertia second(J=J2);
  Support support(c=5, d=0.2);
  RealInput tau(unit="N.m", start=0);
  output Real phi(unit="rad") = second.phi;
equation
  connect(tau, torque.tau);
  connect(torque.b, first.a);
  connect(first.b, second.a);
  connect(second.b, support.a);
end CoupledInertias;
