model NonlinearSpring "Example 2 of Casella, Donida, Lovera: two inertias and a spring that grows stiffer"
  connector RealInput = input Real;
  connector RealOutput = output Real;

  connector Flange
    Real phi(unit="rad");
    flow Real tau(unit="N.m");
  end Flange;

  partial model Compliant
    Flange a;
    Flange b;
    Real phi_rel(unit="rad");
    Real tau(unit="N.m");
  equation
    phi_rel = a.phi - b.phi;
    a.tau = -tau;
    b.tau = tau;
  end Compliant;

  model Spring "Equations (45)-(47) of the paper"
    extends Compliant;
    parameter Real K(unit="N.m/rad") = 1;
    parameter Real phi0_squared(unit="rad2") = 1;
  protected
    Real alpha;
    Real tau_l(unit="N.m");
  equation
    tau = tau_l*(1 + alpha);
    tau_l = -K*phi_rel;
    alpha = phi_rel^2/phi0_squared;
  end Spring;

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

  model Torque
    RealInput tau(unit="N.m");
    Flange b;
  equation
    b.tau = -tau;
  end Torque;

  model AngleSensor
    Flange a;
    RealOutput phi(unit="rad");
  equation
    a.tau = 0;
    phi = a.phi;
  end AngleSensor;

  parameter Real p1(unit="kg.m2", min=10, max=15) = 12.5;
  parameter Real p2(unit="kg.m2", min=2, max=4) = 3;
  Torque torque;
  Inertia J1(J=p1);
  Spring spring(K=100, phi0_squared=0.5);
  Inertia J2(J=p2);
  AngleSensor sensor;
  RealInput tau(unit="N.m");
  RealOutput phi(unit="rad");
equation
  connect(tau, torque.tau);
  connect(torque.b, J1.a);
  connect(J1.b, spring.b);
  connect(spring.a, J2.a);
  connect(J2.b, sensor.a);
  connect(sensor.phi, phi);
end NonlinearSpring;
