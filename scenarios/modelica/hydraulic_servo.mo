model HydraulicServo "Valve, cylinder and a mass on a spring; flows grow with the root of the pressure drop"
  connector RealInput = input Real;

  connector Port
    Real p(unit="Pa");
    flow Real q(unit="m3/s") "into the component";
  end Port;

  connector Rod
    Real s(unit="m");
    flow Real f(unit="N");
  end Rod;

  model Valve "Four edges with equal small underlap: it leaks to both sides"
    parameter Real k = 1 "flow of full opening and a root of 1 Pa, m3/(s.Pa^0.5)";
    parameter Real leak(unit="m3/(s.Pa)") = 0;
    parameter Real p_s(unit="Pa") = 1;
    parameter Real p_t(unit="Pa") = 0;
    RealInput opening;
    Port a;
    Port b;
    Real q_a(unit="m3/s");
    Real q_b(unit="m3/s");
  equation
    q_a = if opening >= 0 then k*opening*sqrt(p_s - a.p) else k*opening*sqrt(a.p - p_t);
    q_b = if opening >= 0 then -k*opening*sqrt(b.p - p_t) else -k*opening*sqrt(p_s - b.p);
    a.q = -q_a - leak*(p_s - a.p) + leak*(a.p - p_t);
    b.q = -q_b - leak*(p_s - b.p) + leak*(b.p - p_t);
  end Valve;

  model Cylinder
    parameter Real A(unit="m2") = 1;
    parameter Real V(unit="m3") = 1 "of each chamber, rod in the middle";
    parameter Real bulk(unit="Pa") = 1 "modulus of the oil";
    Port a;
    Port b;
    Rod rod;
    Real v(unit="m/s");
    Real p_a(unit="Pa", start=5e6, nominal=1e6);
    Real p_b(unit="Pa", start=5e6, nominal=1e6);
  equation
    p_a = a.p;
    p_b = b.p;
    v = der(rod.s);
    V/bulk*der(p_a) = a.q - A*v;
    V/bulk*der(p_b) = b.q + A*v;
    rod.f = -A*(p_a - p_b);
  end Cylinder;

  model Mass
    parameter Real m(unit="kg") = 1;
    Rod a;
    Rod b;
    Real s(unit="m", start=0, nominal=0.01);
    Real v(unit="m/s", start=0);
  equation
    s = a.s;
    s = b.s;
    v = der(s);
    m*der(v) = a.f + b.f;
  end Mass;

  model Support "Spring and damper to the ground"
    parameter Real c(unit="N/m") = 1;
    parameter Real d(unit="N.s/m") = 0;
    Rod a;
    Real v(unit="m/s");
  equation
    v = der(a.s);
    a.f = c*a.s + d*v;
  end Support;

  model Force "An external force on the mass"
    RealInput f(unit="N");
    Rod b;
  equation
    b.f = -f;
  end Force;

  parameter Real m(unit="kg", min=80, max=160) = 100 "moved mass";
  parameter Real bulk(unit="Pa", min=0.7e9, max=1.4e9) = 1e9 "modulus of the oil, with its air";
  parameter Real p_s(unit="Pa") = 1e7 "supply";
  Valve valve(k=2e-7, leak=2e-12, p_s=p_s);
  Cylinder cylinder(A=1e-3, V=5e-4, bulk=bulk);
  Mass mass(m=m);
  Support support(c=2e4, d=500);
  Force force;
  RealInput opening(start=0);
  RealInput f(unit="N", start=0);
  output Real s(unit="m") = mass.s;
equation
  connect(opening, valve.opening);
  connect(valve.a, cylinder.a);
  connect(valve.b, cylinder.b);
  connect(cylinder.rod, mass.a);
  connect(mass.b, support.a);
  connect(f, force.f);
  connect(force.b, mass.b);
end HydraulicServo;
