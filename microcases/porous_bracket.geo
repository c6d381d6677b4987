// Angle bracket, in mm: a foot with two bolt holes, an upright web with an eye, a rib between them.
SetFactory("OpenCASCADE");
Box(1) = {0, -15, 0, 40, 30, 8};            // foot
Box(2) = {0, -15, 0, 8, 30, 45};            // web
Point(101) = {8, -4, 8};
Point(102) = {32, -4, 8};
Point(103) = {8, -4, 34};
Line(201) = {101, 102};
Line(202) = {102, 103};
Line(203) = {103, 101};
Curve Loop(301) = {201, 202, 203};
Plane Surface(401) = {301};
Extrude {0, 8, 0} { Surface{401}; }         // rib, volume 3
Cylinder(11) = {28, -9.5, -1, 0, 0, 10, 3};
Cylinder(12) = {28, 9.5, -1, 0, 0, 10, 3};
Cylinder(13) = {-1, 0, 38, 10, 0, 0, 4};
BooleanUnion(20) = { Volume{1}; Delete; }{ Volume{2, 3}; Delete; };
BooleanDifference(21) = { Volume{20}; Delete; }{ Volume{11, 12, 13}; Delete; };
e = 1e-3;
foot() = Surface In BoundingBox {-e, -15 - e, -e, 40 + e, 15 + e, e};
eye() = Surface In BoundingBox {-e, -4 - e, 34 - e, 8 + e, 4 + e, 42 + e};
Physical Surface("foot") = {foot()};
Physical Surface("eye") = {eye()};
Physical Volume("bracket") = {21};
