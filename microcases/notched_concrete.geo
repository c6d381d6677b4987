// Notched beam of hexahedra, in mm: strips below both ends and above the notch, where it is bent.
h = Mesh.MeshSizeMax;                       // largest edge of an element
depth = 400;
width = 200;
notch = 160;
x() = {0, 40, 800, 840, 1600, 1640};          // ends of strips, spans and notch
Point(1) = {0, 0, 0};
rows[] = {notch, depth - notch};
lower = 1;
For r In {0:1}
  line[] = Extrude {0, 0, rows[r]} { Point{lower}; Layers{Ceil(rows[r] / h)}; };
  lower = line[0];
  side = line[1];
  For k In {1:5}
    face[] = Extrude {x(k) - x(k - 1), 0, 0} {
      Curve{side}; Layers{Ceil((x(k) - x(k - 1)) / h)}; Recombine;
    };
    side = face[0];
    If (r == 1 || k != 3)
      body[] = Extrude {0, width, 0} { Surface{face[1]}; Layers{1}; Recombine; };
      volumes[] += body[1];
    EndIf
  EndFor
EndFor
Coherence;
e = 1e-3;
left() = Surface In BoundingBox {x(0) - e, -e, -e, x(1) + e, width + e, e};
right() = Surface In BoundingBox {x(4) - e, -e, -e, x(5) + e, width + e, e};
top() = Surface In BoundingBox {x(2) - e, -e, depth - e, x(3) + e, width + e, depth + e};
Physical Surface("left") = {left()};
Physical Surface("right") = {right()};
Physical Surface("top") = {top()};
Physical Volume("beam") = {volumes[]};
